"""Transport that is smooth at many scales, as near/far acquisition finds it."""
