"""The adaptive loop: rounds of patterns until the estimated error meets the target."""
