"""The one reader of electronic data sheets and device configuration files (EDS, DCF; CiA 306)."""
