"""Residual transport: light that a model leaves, fitted to the pictures of all rounds."""
