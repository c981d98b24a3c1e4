"""Footprint acquisition: the light transport of any rig from few random patterns.

The model of one colour channel is

    T = D + diag(f) L S R^T diag(g)

A camera pixel receives direct light from a few projector pixels, its *footprint*: a row of the
sparse matrix D. Indirect light is smooth, up to the factors f and g that carry the texture. Neither
part is known at first; both are estimated in turn from the same pictures of random patterns.

Modules, in reading order:

- `pictures`: the pictures of one projector view, pixel by pixel;
- `candidates`: the sparse matrix D and its splitting into projector views;
- `matching`, `geometry`: the search for the projector pixels that each camera pixel sees;
- `weights`: the light that each of them contributes, by non-negative least squares;
- `reciprocity`: D of cameras that share the rays of the projectors;
- `charts`, `functions`: the B-splines L and R, and the factors f and g;
- `indirect`: the fit of S;
- `model`, `fit`: the whole model, and the loop that fits D and S in turn;
- `patterns`: the random patterns;
- `direct_light`: uses of D in the error estimate and in the residual model;
- `method`: the acquisition in rounds, and its decisions.

`kernels` has the compiled loops.

Sizes have the same letters throughout: M camera rays, N projector rays (of one view or of all), P
pictures, K candidate entries of D, n functions.
"""
