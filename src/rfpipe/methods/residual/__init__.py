"""What a model of the light leaves, estimated from all pictures together, whoever asked for them.

The transport is ``T = M + F K F + diag(d)``: M is any model's, F the root of the floodlit image,
and K symmetric, of any sign, ``K = W^T C W`` with Haar wavelets W. The entries of C are independent
normal deviates whose variances are learned from the pictures. Light isn't negative, which says more
of K than many pictures do.
"""
