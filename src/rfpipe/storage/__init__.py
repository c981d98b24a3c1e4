"""Storage of acquisitions: what stages write and read, in files or in memory."""
