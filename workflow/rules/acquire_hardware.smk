# Such jobs run beside Snakemake, on the rig's host, also when others go to a cluster.
CAPTURED_HERE = SETTINGS.resources.captures == "here"
# Levels that are jobs of their own have taken all pictures before.
RIG_HELD = SETTINGS.resources.jobs == "acquisition"


rule acquire_hardware:
    """A scene's transport, from patterns shown by the rig behind an acquisition server.

    One acquisition at a time has the rig. What it does between two levels' captures takes a
    twentieth of their time (docs/performance.md).
    """
    input:
        levels_before,
    output:
        "results/{scene}/{method}/transport.json",
    log:
        "results/{scene}/{method}/acquire.log",
    benchmark:
        "results/{scene}/{method}/acquire.benchmark.tsv"
    localrule: CAPTURED_HERE and RIG_HELD
    conda:
        "../envs/rfpipe.yaml"
    threads: threads
    resources:
        **WHERE_THE_RIG_IS,
        **asked("acquire"),
        **WITHIN,
        rig=int(RIG_HELD),
    params:
        plan=plan,
        stages=stages,
    script:
        "../scripts/acquire_hardware.py"


rule verify_hardware:
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
        **WHERE_THE_RIG_IS,
        **asked("verification"),
        **WITHIN,
        rig=1,
    params:
        plan=plan,
        stages=verification,
    script:
        "../scripts/verify_hardware.py"
