"""Reference images of an acquisition, and checks of its rig and light.

Black level, defective pixels and floodlit image, estimated from the reference brackets; the
symmetry test; and changes of rig, lamp and room light, estimated from check pictures.
"""
