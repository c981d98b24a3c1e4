rule verification:
    """Errors of a transport on verification pictures of the same rig."""
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
        settings=settings_of("capture", "merge"),
        pictures=lambda wildcards: of_scene(wildcards.scene).verification_pictures,
        rig=rig,
    script:
        "../scripts/verification.py"


rule bound:
    """Comparison of the verified errors with their bounds.

    The last rule: a run that fails here has its report and all results.
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
