"""Files of other programs, and outputs of this one, read for evaluation."""
