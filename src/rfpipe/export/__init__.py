"""What leaves rfpipe: relit pictures, photographs with patterns, movies of a light that moves.

The matrix itself is written by `rfpipe.transport.Transport.save`.
"""

from rfpipe.export.movies import PATHS, moving_light, relit_movie, relit_pictures, write_movie
from rfpipe.export.photographs import write_lights, write_normals, write_photographs
from rfpipe.export.rays import rays_at

__all__ = [
    "PATHS",
    "moving_light",
    "rays_at",
    "relit_movie",
    "relit_pictures",
    "write_lights",
    "write_movie",
    "write_normals",
    "write_photographs",
]
