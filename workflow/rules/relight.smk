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


rule relight:
    """The transport under the reference patterns, beside what is true of the scene."""
    input:
        "results/{scene}/{method}/transport.json",
    output:
        "results/{scene}/{method}/relight.json",
    log:
        "results/{scene}/{method}/relight.log",
    benchmark:
        "results/{scene}/{method}/relight.benchmark.tsv"
    conda:
        "../envs/rfpipe.yaml"
    resources:
        **ASKED,
    params:
        scene=scene_settings,
        code=lambda wildcards: code_of(SETTINGS, wildcards.scene),
    script:
        "../scripts/relight.py"


rule sweep:
    """Speed against error: the same acquisition at other tolerances, in one process."""
    output:
        "results/{scene}/{method}/sweep.json",
    log:
        "results/{scene}/{method}/sweep.log",
    benchmark:
        "results/{scene}/{method}/sweep.benchmark.tsv"
    conda:
        "../envs/rfpipe.yaml"
    resources:
        **ASKED,
    params:
        settings=sweep_settings,
        code=lambda wildcards: code_of(SETTINGS, wildcards.scene, wildcards.method),
    script:
        "../scripts/sweep.py"
