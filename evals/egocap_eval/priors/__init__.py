"""In: motion clips. Out: the tracker's pose prior, Gaussian motion prior and motion network.
How they are learned is edited here; how the tracker uses them, in `egocap.pose`."""
