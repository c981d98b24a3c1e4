"""The multilevel transport of dual photography (thesis §3.2)."""
