"""Videos and folders of pictures of a rig's cameras in; sequences without truth out.

`egocap.media` decodes them; when each view was taken and how its colours differ is estimated here
and stored by `egocap.data.footage`. Poses are estimated elsewhere.
"""
