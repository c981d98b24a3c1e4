"""Every method on every scene: errors against patterns and light (``make benchmark``)."""
