"""Things people use: held, thrown, ridden, or standing in the way."""
