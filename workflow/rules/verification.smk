rule verification:
    """A scene's transport beside pictures that no method saw, taken by the same rig."""
    input:
        "results/{scene}/{method}/transport.json",
    output:
        "results/{scene}/{method}/verification.json",
    log:
        "results/{scene}/{method}/verification.log",
    benchmark:
        "results/{scene}/{method}/verification.benchmark.tsv"
    localrule: CAPTURED_HERE
    conda:
        "../envs/rfpipe.yaml"
    threads: threads
    resources:
        **WITHIN,
        **AT_THE_RIG,
    params:
        settings=lambda wildcards: {
            stage: settings_of(stage)(wildcards) for stage in ("capture", "merge")
        },
        pictures=lambda wildcards: of_scene(wildcards.scene).verification_pictures,
        by=lambda wildcards: rig(wildcards.scene)["by"],
        rig=lambda wildcards: rig(wildcards.scene)["rig"],
    script:
        "../scripts/verification.py"


rule bound:
    """Whether what was acquired is as near to the scene as was asked for.

    Last of all: a run that fails here has its report, and all that was acquired.
    """
    input:
        acquired=every_bounded,
        page=["results/report/index.html"] if SETTINGS.has_report else [],
    output:
        touch("results/verified"),
    log:
        "results/verified.log",
    conda:
        "../envs/rfpipe.yaml"
    params:
        bounds=BOUNDS,
    script:
        "../scripts/bound.py"
