"""Light transport operators, their storage, and analyses of a scene that are based on them.

All transports share the interface of `base.Transport`: relighting and analyses (`relightable`),
products and entries (`algebra`), storage (`storage`). They differ in their form, the ``kind`` of a
store:

===============  =================================================================================
kind             method and form
===============  =================================================================================
`dense`          `brute_force`, `hadamard`: one matrix per channel
`multilevel`     `dual`: a sparse matrix of blocks and pixels per level; `responses`
`hierarchical`   `symmetric`: rank-1 leaves over pairs of blocks
`low_rank`       direct light of `near_far`: a diagonal; also rows of masked pixels (`filling`)
`multiscale`     indirect light of `near_far`: symmetric, between smooth functions
                 (`function_pairs`)
`footprints`     `footprints`: sparse direct light, and smooth indirect light
`wavelet`        residual of a model on coaxial rigs; on all others its kind is `footprints`
`sum`            a sum of other kinds, such as `near_far` with its residual
===============  =================================================================================

Further modules make a transport of another one or of a matrix: `regrouping` (coarser or fewer
rays), `operators` (a user's matrix or linear operator), `matrix_reading` and `matrix_export`
(files), `collection` (a field of transports). Analyses have a module each: `separation`,
`compensation`, `correspondence`, `normals`, `light_interpolation`.
"""

from rfpipe.transport.base import Transport, save_transport
from rfpipe.transport.regrouping import coarser
from rfpipe.transport.relightable import TransposedTransport
from rfpipe.transport.storage import open_transport

__all__ = ["Transport", "TransposedTransport", "coarser", "open_transport", "save_transport"]
