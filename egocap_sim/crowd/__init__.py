"""The wearer's motion and a table of behaviours in; bystanders that walk, stand and greet out.

Their motion is played back, not simulated. A new behaviour is one function in `bystanders`.
"""
