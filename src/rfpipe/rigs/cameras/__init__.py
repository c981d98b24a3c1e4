"""What drivers of cameras share, and those of GenICam, photo and web cameras."""
