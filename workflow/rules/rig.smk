# What stands before a scene, and what jobs ask for that need a real rig.

HAS_RIG = SETTINGS.capture.rig == "remote"
CAPTURED_HERE = HAS_RIG and SETTINGS.resources.captures == "here"

rig = cache(partial(rig_of, SETTINGS))


def of_capture(name):
    """A setting of the capture, as a resource."""
    return lambda wildcards: str(getattr(of_scene(wildcards.scene).capture, name) or "")


# Where the rig is, and what puts a scene before it: resources, since they shape no result.
WHERE = ("url", "token_file", "patience_seconds", "placing")
AT_THE_RIG = {"rig": 1, **{f"rig_{name}": of_capture(name) for name in WHERE}}
AT_THE_RIG = AT_THE_RIG if HAS_RIG else {}
