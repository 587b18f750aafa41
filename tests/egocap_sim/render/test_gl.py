"""Where there is no OpenGL, the user is told what to install."""

from __future__ import annotations

import subprocess
import sys

import numpy as np
import pytest

from egocap.errors import MachineError

ASK = """
import sys
{setup}
from egocap.errors import MachineError
try:
    from egocap_sim.render.gl import Context
    Context()
except MachineError as error:
    assert error.exit_code == 1
    print(error)
"""


@pytest.mark.parametrize(
    "setup",
    [
        "sys.modules['OpenGL.EGL'] = None",
        "import os; os.environ['__EGL_VENDOR_LIBRARY_FILENAMES'] = '/nonexistent'",
    ],
    ids=["library missing", "driver missing"],
)
def test_a_machine_without_opengl_names_the_packages(setup):
    done = subprocess.run(
        [sys.executable, "-c", ASK.format(setup=setup)], capture_output=True, text=True, timeout=600
    )
    assert done.returncode == 0, done.stderr
    assert "libegl1 libgl1 libgl1-mesa-dri" in done.stdout


def test_a_context_says_what_draws(gl):
    from egocap_sim.render.gl import Context

    context = Context()
    assert context.renderer and int(context.version.split(".")[0]) >= 4
    context.close()
    context.close()


def test_more_samples_than_opengl_takes_are_refused(gl):
    from egocap_sim.render.framebuffer import AtlasBuffer
    from egocap_sim.render.gl import Context

    context = Context()
    with pytest.raises(MachineError, match="1024 samples; OpenGL takes"):
        AtlasBuffer(np.ones((8, 8), bool), 1024)
    context.close()


def test_torch_for_cuda_can_be_imported_after_a_context_was_made():
    """Its triton and Mesa's software renderer each bring their own LLVM."""
    pytest.importorskip("triton", reason="torch is not the build for CUDA")
    code = "from egocap_sim.render.gl import Context; context = Context(); import triton"
    subprocess.run([sys.executable, "-c", code], check=True, timeout=600)


def test_libraries_for_scenes_and_windows_load_when_used():
    code = (
        "import sys, egocap_sim.render.gl\n"
        "unused = {'networkx', 'pyglet', 'pyrender.viewer', 'trimesh', 'PIL', 'freetype'}\n"
        "assert not unused & set(sys.modules), unused & set(sys.modules)\n"
        "import pyrender\n"
        "box = pyrender.mesh.trimesh.creation.box()\n"
        "assert len(pyrender.Mesh.from_trimesh(box).primitives) == 1\n"
        "assert (pyrender.node.transformations.identity_matrix() == pyrender.Node().matrix).all()\n"
        "import trimesh.graph, networkx\n"
        "assert len(trimesh.graph.nx.path_graph(3)) == len(networkx.path_graph(3)) == 3\n"
        "assert pyrender.Scene().get_nodes() == set()\n"
    )
    subprocess.run([sys.executable, "-c", code], check=True)
