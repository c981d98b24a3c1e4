"""The stages of an acquisition, and the loops that run them.

====================================================== =============================================
for each level                                         schedule, capture, merge, normalize, refine
once per acquisition                                   assemble, verification
once per acquisition, to report on it                  relight
once per run, to report on all acquisitions            evaluate
loops over the levels                                  acquisition (any storage), acquire (memory)
inputs of stages                                       plan, settings, context, rig_sources
parts of a capture                                     brackets, watch
jobs of the workflow, rigs without a server, forecasts job, offline, forecast
====================================================== =============================================

The workflow runs the stages on files, as jobs. `rfpipe.acquire` runs the stages of each level and
assembles the transport in memory, and verifies it if pictures are requested. It doesn't relight.
"""
