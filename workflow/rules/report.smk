from rfpipe.stages.evaluating.studies import FIGURES, STUDIES

# Simulated scenes on which the methods are compared: no part of what a rig's report is about.
SHOWN_STUDIES = STUDIES if SETTINGS.capture.rig == "simulated" else []
if SETTINGS.report.figures is not None:
    SHOWN_STUDIES = [*SHOWN_STUDIES, *FIGURES]

PAGE_TEMPLATE = Path(rfpipe.__file__).parent / "report" / "page.html.j2"


rule studies:
    """What the report shows beside the acquired scenes."""
    output:
        "results/studies/{study}.json",
    log:
        "results/studies/{study}.log",
    benchmark:
        "results/studies/{study}.benchmark.tsv"
    wildcard_constraints:
        study="|".join([*STUDIES, *FIGURES]),
    conda:
        "../envs/rfpipe.yaml"
    resources:
        **asked_by_run("results/studies/{wildcards.study}.log"),
        runtime=LONG_MINUTES,
    params:
        settings=study_settings,
        code=study_code,
    script:
        "../scripts/studies.py"


rule evaluate:
    """All error figures, in one job since the colour library takes long to load."""
    input:
        relit=every_acquisition("relight.json"),
        swept=every_sweep("sweep.json"),
    output:
        errors=report(
            "results/report/tables/errors.csv", caption="../report/errors.rst"
        ),
        speed_error=report(
            "results/report/tables/speed_error.csv",
            caption="../report/speed_error.rst",
        ),
    log:
        "results/report/evaluate.log",
    benchmark:
        "results/report/evaluate.benchmark.tsv"
    conda:
        "../envs/rfpipe.yaml"
    threads: all_cores
    resources:
        **asked_by_run("results/report/evaluate.log"),
        workers=SETTINGS.resources.workers,
    params:
        seconds_per_pattern=SETTINGS.capture.seconds_per_pattern,
        code=stage_code("stages.evaluating.evaluate"),
    script:
        "../scripts/evaluate.py"


rule report:
    """The thesis' figures and tables for the acquired scenes, on one page."""
    input:
        relit=every_acquisition("relight.json"),
        studies=expand("results/studies/{study}.json", study=SHOWN_STUDIES),
        errors="results/report/tables/errors.csv",
        speed_error="results/report/tables/speed_error.csv",
        views=every_view,
        verified=every_verification,
        # what `make bench` left, if anything, when the workflow starts
        benchmarks=sorted(map(str, Path("results/bench").glob("*.csv"))),
    output:
        page=report("results/report/index.html", caption="../report/report.rst"),
        numbers="results/report/results.json",
    log:
        "results/report/report.log",
    benchmark:
        "results/report/report.benchmark.tsv"
    conda:
        "../envs/rfpipe.yaml"
    resources:
        **asked_by_run("results/report/report.log"),
        runtime=LONG_MINUTES,
    params:
        settings=SHAPING,
        code=report_code,
        template=fingerprint(PAGE_TEMPLATE.read_text(encoding="utf-8")),
    script:
        "../scripts/report.py"


rule bound:
    """Whether what was acquired is as near to the pictures that verify it as was asked for.

    Last of all: a run that fails here has its report, and all that was acquired.
    """
    input:
        verified=every_verification,
        page=["results/report/index.html"] if SETTINGS.has_report else [],
    output:
        touch("results/verified"),
    log:
        "results/verified.log",
    conda:
        "../envs/rfpipe.yaml"
    params:
        bound=SETTINGS.verification.fail_above,
    script:
        "../scripts/bound.py"
