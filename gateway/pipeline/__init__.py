"""From files to an estimate or a diagnosis, and to the result that is handed over."""
