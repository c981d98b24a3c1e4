from rfpipe.stages.folder import AcquisitionFolder


rule drop_raw:
    """Free the disk of raw exposures that are merged, where capture.keep_raw became false.

    Captures of a run that has had this setting from its beginning are freed by their merges.
    """
    input:
        "results/{scene}/{method}/transport.json",
    output:
        touch("results/{scene}/{method}/raw_dropped"),
    log:
        "results/{scene}/{method}/drop_raw.log",
    localrule: True
    conda:
        "../envs/rfpipe.yaml"
    resources:
        **WITHIN,
    script:
        "../scripts/drop_raw.py"


def raw_to_drop(wildcards):
    """The acquisitions whose merged raw exposures are no longer to be kept."""
    return [
        f"results/{scene}/{method}/raw_dropped"
        for scene, method in SETTINGS.acquisitions
        if not of_scene(scene).capture.keep_raw
        and AcquisitionFolder(Path("results", scene, method)).has_merged_raw()
    ]
