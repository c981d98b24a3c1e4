"""Symmetric photography: blocks of low rank, and symmetry (thesis ch. 5, C.2)."""
