"""Footprint acquisition: the light transport of any rig from few random patterns.

The model of one colour channel is

    T = D + diag(f) L S R^T diag(g)

A camera pixel receives direct light from a few projector pixels, its *footprint*: a row of the
sparse matrix D. Indirect light is smooth, up to the scale factors f and g that carry the texture.
Neither part is known at first; both are estimated in turn from the same pictures of random
patterns.

Modules, in reading order:

- `pictures`: the pictures of one projector view, pixel by pixel;
- `candidates`: the sparse matrix D, stored by projector view;
- `matching`, `geometry`: the search for the projector pixels that each camera pixel sees;
- `weights`: the light that each of them contributes, by non-negative least squares;
- `reciprocity`: D of light fields of coaxial pairs, where ``D = D^T``;
- `charts`, `functions`: the B-splines L and R, and the factors f and g;
- `indirect`: the fit of S;
- `problem`: rig, pictures and limits of a fit;
- `search`: footprints on all projector views;
- `scales`: the fit of S with functions of finer and finer scales;
- `model`, `fit`: the whole model, and the loop that fits D and S in turn;
- `patterns`: the random patterns;
- `direct_light`: uses of D in the error estimate and in the residual model;
- `method`: the acquisition in rounds, and its decisions.

`kernels` and `matching_kernels` have the compiled loops.

Letters have the same meaning throughout the package.

======  ============================================================================================
letter  size
======  ============================================================================================
``M``   camera rays
``N``   projector rays, of one view or of all views
``C``   colour channels
``P``   pictures; of one view, or of all views one after the other
``K``   candidate entries of D
``k``   candidate entries of one camera ray, in one row of D
``m``   selected camera rays
``n``   functions, the columns of L and of R
======  ============================================================================================

======  ============================================================================================
letter  index or array
======  ============================================================================================
i, j    index of a camera ray, of a projector ray
q       index of a picture
``p``   (N, P) patterns, one per column: weights from 0 to 1
``c``   (M, P) radiance in the pictures of the patterns p
``F``   (M,) floodlit image
======  ============================================================================================

The modules' tables define the others. A *core* is an entry of S; `functions` describes how cores
are computed from the unknowns of the fit. A *pixel* of the camera or of the projector is a ray of
one view.
"""
