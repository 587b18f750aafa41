"""Joint names and a person's proportions in; the skeleton, its kinematics and its Gaussians out.

`labels` is the one table of joints and `joint_names` maps other data sets' names to it.
"""
