"""Measurements on real photographs, and on simulated ones like them."""
