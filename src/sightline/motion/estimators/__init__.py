"""One estimator per file, all of the same signature: differences and epochs in, Motion out."""
