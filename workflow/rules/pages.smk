# What the rules behind the transports share: sweeps, viewers' pages and the report.

from rfpipe.errors import RfpipeError
from rfpipe.provenance import fingerprint
from rfpipe.stages.evaluating.studies import FIGURES, STUDIES
from rfpipe.store.files import digest_of


def scene_settings(wildcards):
    """What is true of a scene, however often and by whatever method it is acquired."""
    return SETTINGS.scenes[wildcards.scene].itself()


def every_sweep(name):
    """A file of each scene and method that is acquired at several tolerances."""
    return [
        f"results/{scene}/{method}/{name}"
        for scene, method in SETTINGS.acquisitions
        if is_swept(SETTINGS, scene, method)
    ]


def sweep_settings(wildcards):
    """The settings of one scene and method's sweep."""
    section = SETTINGS.methods_of(wildcards.scene)[wildcards.method]
    shaping = of_scene(wildcards.scene).shaping()
    return {
        **{name: part for name, part in shaping.items() if name != "verification"},
        "scenes": {wildcards.scene: scene_settings(wildcards)},
        "methods": {wildcards.method: section.model_dump(mode="json")},
        "report": {"trials": SHAPING["report"]["trials"]},
    }


def every_view(wildcards):
    """The page of each scene and method on which one paints with light."""
    return [
        f"results/report/view/{scene}_{method}.html"
        for scene, method in SETTINGS.acquisitions
    ]


def other_acquisitions(wildcards):
    """The transports of a scene by its other methods."""
    return [
        f"results/{wildcards.scene}/{method}/transport.json"
        for method in SETTINGS.methods_of(wildcards.scene)
        if method != wildcards.method
    ]


# What the pages run, which is no Python.
VIEWER_WEB = fingerprint(
    [
        digest_of(path.read_bytes())
        for path in sorted((Path(rfpipe.__file__).parent / "viewer").glob("*/*.*"))
    ]
)


def study_settings(wildcards):
    """The settings of the studies, which have scenes of their own."""
    shown = ["figures"] if wildcards.study in FIGURES else ["resolutions"]
    settings = {
        **SHAPING,
        "capture": {**SHAPING["capture"], "rig": "simulated"},
        "report": {name: SHAPING["report"][name] for name in shown},
        "scenes": {"none_of_the_run": {"kind": "plane", "surfaces": ["white"]}},
    }
    del settings["verification"]
    return settings


def every_item(wildcards):
    """What the catalogue tells of each scene and method beside its transport."""
    relit = [
        f"results/{scene}/{method}/relight.json"
        for scene, method in SETTINGS.acquisitions
        if SETTINGS.scenes[scene].has_truth
    ]
    return [*relit, *every_verification(wildcards), *every_view(wildcards)]


def list_collection():
    """Write the catalogue of a collection, whatever became of it until now."""
    if SETTINGS.collection is None:
        return
    from rfpipe.report.catalogue import write_catalogue

    try:
        counts = write_catalogue(SETTINGS, Path("results"))
    except RfpipeError as error:  # a page more or less doesn't change how a run ended
        print(f"rfpipe: no catalogue: {error}")
        return
    states = ", ".join(f"{count} {state}" for state, count in counts.items() if count)
    print(f"rfpipe: results/catalogue/index.html: {states}")
