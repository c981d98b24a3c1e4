"""What leaves rfpipe: pictures of rays, relit pictures and movies of a light that moves.

The matrix itself is written by `rfpipe.transport.Transport.save`.
"""

from rfpipe.export.movies import PATHS, moving_light, relit_movie, relit_pictures, write_movie
from rfpipe.export.rays import ray_pictures, rays_at
from rfpipe.export.scales import Scale

__all__ = [
    "PATHS",
    "Scale",
    "moving_light",
    "ray_pictures",
    "rays_at",
    "relit_movie",
    "relit_pictures",
    "write_movie",
]
