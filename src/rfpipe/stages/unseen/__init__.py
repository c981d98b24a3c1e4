"""Verification: pictures that no method saw, compared with what the transport makes of them."""
