"""The hierarchical tensor of symmetric photography (thesis ch. 4)."""
