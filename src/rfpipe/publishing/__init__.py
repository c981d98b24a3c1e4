"""Publications of results: citable crates, and uploads to buckets."""
