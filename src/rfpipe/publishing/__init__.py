"""What leaves the lab: crates that can be cited, buckets, and reading from zips and addresses."""
