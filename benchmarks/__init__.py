"""What compares and measures: methods, rivals, speed (README.md)."""
