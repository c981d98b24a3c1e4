rule acquire_hardware:
    """A scene's transport, from patterns shown by the rig behind an acquisition server.

    One acquisition at a time has the rig. What it does between two levels' captures takes a
    twentieth of their time (docs/performance.md).
    """
    output:
        "results/{scene}/{method}/transport.json",
    log:
        "results/{scene}/{method}/acquire.log",
    benchmark:
        "results/{scene}/{method}/acquire.benchmark.tsv"
    conda:
        "../envs/rfpipe.yaml"
    threads: threads
    resources:
        rig=1,
        mem_mib=MEMORY_MIB,
        cluster=SETTINGS.resources.cluster or "",
        # where the rig is, and how long to wait for it, shapes no result
        rig_url=lambda wildcards: capture(wildcards).url,
        rig_token_file=lambda wildcards: capture(wildcards).token_file or "",
        rig_patience=lambda wildcards: str(capture(wildcards).patience_seconds),
        rig_placing=lambda wildcards: capture(wildcards).placing or "",
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
    conda:
        "../envs/rfpipe.yaml"
    threads: threads
    resources:
        rig=1,
        mem_mib=MEMORY_MIB,
        cluster=SETTINGS.resources.cluster or "",
        # where the rig is, and how long to wait for it, shapes no result
        rig_url=lambda wildcards: capture(wildcards).url,
        rig_token_file=lambda wildcards: capture(wildcards).token_file or "",
        rig_patience=lambda wildcards: str(capture(wildcards).patience_seconds),
        rig_placing=lambda wildcards: capture(wildcards).placing or "",
    params:
        plan=plan,
        stages=verification,
    script:
        "../scripts/verify_hardware.py"
