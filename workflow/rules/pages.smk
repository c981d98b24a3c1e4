# What the rules behind the transports share: viewers' pages and the report.

import rfpipe
from rfpipe.errors import RfpipeError
from rfpipe.provenance import fingerprint
from rfpipe.store.files import digest_of


def scene_settings(wildcards):
    """What is true of a scene, however often and by whatever method it is acquired."""
    return SETTINGS.scenes[wildcards.scene].itself()


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


# The package that makes the pages, with what they run.
VIEWER = fingerprint(
    [
        digest_of(path.read_bytes())
        for path in sorted(Path(rfpipe.__file__).with_name("viewer").rglob("*.*"))
        if path.suffix != ".pyc"
    ]
)


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


# The mean error of each acquisition above which the run fails, where there is such a bound.
BOUNDS = {
    f"{scene} by {method}": SETTINGS.bound_of(scene, method)
    for scene, method in SETTINGS.acquisitions
    if SETTINGS.bound_of(scene, method) is not None
}


def every_bounded(wildcards):
    """The verification of each acquisition that has a bound, or else its transport."""
    return [
        f"results/{scene}/{method}/{name}.json"
        for scene, method in SETTINGS.acquisitions
        for name in [
            "verification" if of_scene(scene).verification_pictures else "transport"
        ]
        if f"{scene} by {method}" in BOUNDS
    ]


def report_others(failures):
    """Write the report of the acquisitions in which no job failed, in a run that keeps going."""
    failed = {
        (failure.scene, failure.method): failure
        for failure in failures
        if failure.scene
    }
    if not failed or len(failed) < len(failures) or not SETTINGS.has_report:
        return
    from rfpipe.report.others import build_report_of_others

    try:
        page = build_report_of_others(SETTINGS, Path("results"), failed)
    except RfpipeError as error:
        print(f"rfpipe: no report of the others: {error}")
    else:
        print(f"rfpipe: report of the others: {page}" if page else "")


def every_verification(wildcards):
    """The verification of each scene and method, if there are to be any."""
    return every_acquisition(
        "verification.json", lambda scene: of_scene(scene).verification_pictures
    )
