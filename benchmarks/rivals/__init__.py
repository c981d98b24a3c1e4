"""Methods from elsewhere, for comparison: compressive sensing and optical low rank."""

RIVALS = {
    "compressive": "benchmarks.rivals.compressive:Compressive",
    "low_rank": "benchmarks.rivals.low_rank:LowRank",
}
"""Paths of the methods, as settings and `rfpipe.acquire` take them, by their names in tables."""
