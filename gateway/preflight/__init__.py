"""The drives are asked what they are, and judged, before anything is written or moves."""
