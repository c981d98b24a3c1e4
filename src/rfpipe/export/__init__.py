"""Export for other programs: relit pictures, photographs, relightable images, and movies.

`rfpipe.transport.Transport.save` writes the transport matrix.
"""

from rfpipe.export.movies import PATHS, moving_light, relit_movie, relit_pictures, write_movie
from rfpipe.export.photographs import write_lights, write_normals, write_photographs
from rfpipe.export.rays import rays_at
from rfpipe.export.relightable_images import write_relightable_image

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
    "write_relightable_image",
]
