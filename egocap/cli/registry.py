"""The commands of `egocap`: each of the modules beside this one adds its own."""

from tyro.extras import SubcommandApp

app = SubcommandApp()
