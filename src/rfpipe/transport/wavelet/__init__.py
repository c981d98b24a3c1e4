"""Symmetric transport of any shape by Haar wavelets on cells of pixels."""
