"""What a capture needs besides its patterns: brackets, the lamp, the disk."""
