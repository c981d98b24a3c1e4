"""The model of any rig: each camera pixel's few projector pixels, and smooth indirect light."""
