"""Images to matches: where to match, the sub-pixel matcher, its covariance. Knows nothing of attitude."""
