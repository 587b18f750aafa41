#!/bin/sh
# Software OpenGL through EGL, which the renderer needs; installs it where apt and root allow.
set -eu
have() { ldconfig -p 2>/dev/null | grep -q "$1"; }
if have libEGL.so.1 && have libGL.so.1 && { have libEGL_mesa.so.0 || have libEGL_nvidia.so.0; }; then
    exit 0
fi
packages="libegl1 libgl1 libgl1-mesa-dri"
if [ "$(id -u)" = 0 ] && command -v apt-get >/dev/null; then
    echo "installing $packages"
    apt-get update -qq
    DEBIAN_FRONTEND=noninteractive apt-get install -qq -y --no-install-recommends $packages
else
    echo "OpenGL through EGL is missing and cannot be installed without root and apt." >&2
    echo "Install the Debian packages $packages, or your system's EGL and Mesa." >&2
    exit 1
fi
