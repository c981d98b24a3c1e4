"""What leaves rfpipe: pictures of rays, relit pictures and movies of light paths.

The matrix itself is written by `rfpipe.transport.Transport.save`.
"""

from rfpipe.export.movies import MOVIE_FILES, write_movie
from rfpipe.export.paths import PATHS, LightPath, light_path
from rfpipe.export.rays import ray_pictures, rays_at
from rfpipe.export.relit import relit_movie, relit_pictures
from rfpipe.export.scales import Scale

__all__ = [
    "MOVIE_FILES",
    "PATHS",
    "LightPath",
    "Scale",
    "light_path",
    "ray_pictures",
    "rays_at",
    "relit_movie",
    "relit_pictures",
    "write_movie",
]
