"""Methods from elsewhere, for comparison: Hadamard, compressive sensing, optical low rank."""
