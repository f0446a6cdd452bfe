#!/bin/sh
# pymeshlab loads libGL.so.1 and libOpenGL.so.0, which a bare system lacks. Find out whether they are
# there; install them where that is possible without asking, else say how. Never fails: `vhp check`
# and `vhp phantom` need neither.
# Usage: tools/system_libraries.sh [PYTHON]
set -u
python=${1:-python3}
[ "$(uname -s)" = Linux ] && command -v "$python" >/dev/null || exit 0

missing() {
    for library in libGL.so.1 libOpenGL.so.0; do
        "$python" -c "import ctypes; ctypes.CDLL('$library')" 2>/dev/null || echo "$library"
    done
}

wanted=$(missing | tr '\n' ' ')
[ -n "$wanted" ] || exit 0
if [ "$(id -u)" = 0 ] && command -v apt-get >/dev/null; then
    echo "installing libgl1 and libopengl0 for pymeshlab" >&2
    export DEBIAN_FRONTEND=noninteractive
    { apt-get update -qq && apt-get install -qq --no-install-recommends libgl1 libopengl0; } >/dev/null 2>&1
    wanted=$(missing | tr '\n' ' ')
fi
[ -z "$wanted" ] || echo "note: pymeshlab can't load ${wanted}- what needs it is skipped; \
Debian and Ubuntu: sudo apt-get install libgl1 libopengl0; Fedora: sudo dnf install libglvnd-glx libglvnd-opengl" >&2
exit 0
