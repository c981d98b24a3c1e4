"""Near/far acquisition: direct light and smooth indirect light on coaxial rigs."""
