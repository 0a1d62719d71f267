"""Points of dense clouds: their views, displacement and noise, and thinning in the images."""
