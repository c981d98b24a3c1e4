rule refine:
    """What a level's images tell about the transport, and what is left to ask."""
    input:
        schedule="results/{scene}/{method}/L{level}/schedule.json",
        merged="results/{scene}/{method}/L{level}/merge.json",
        normalized="results/{scene}/{method}/L{level}/normalize.json",
        known=refined_above,
    output:
        "results/{scene}/{method}/L{level}/refine.json",
    log:
        "results/{scene}/{method}/L{level}/refine.log",
    benchmark:
        "results/{scene}/{method}/L{level}/refine.benchmark.tsv"
    conda:
        "../envs/rfpipe.yaml"
    threads: threads
    resources:
        mem_mib=MEMORY_MIB,
    params:
        plan=plan,
        code=stage_code("refine"),
    script:
        "../scripts/refine.py"
