#!/usr/bin/env bash
# Makes .venv with the extras named in EXTRAS, from constraints.txt. Quiet; the log is shown when a step fails.
set -euo pipefail
cd "$(dirname "$0")/.."
log=.setup.log
trap 'exit 130' INT  # Ctrl-C: without this Bash goes on when the command it waits for ends well all the same
if [ ! -w . ]; then
    printf '  setup: %s cannot be written: the environment (.venv) is made in the clone; copy it to where you may write\n' "$PWD" >&2
    exit 1
fi
# Trust what this machine trusts (a company's own certificate authority, for example).
if [ -s /etc/ssl/certs/ca-certificates.crt ]; then export UV_SYSTEM_CERTS="${UV_SYSTEM_CERTS:-1}"; fi
: >"$log"
step() {
    printf '  setup: %s ...\n' "$1" >&2
    shift
    "$@" >>"$log" 2>&1 && return
    if grep -qiE "$NO_NETWORK" "$log"; then
        printf '  setup: the package index cannot be reached; the first setup needs a network (a mirror or proxy: PIP_INDEX_URL,\n' >&2
        printf '  UV_INDEX_URL, HTTPS_PROXY). Then run it again: what is there is kept. The log: %s\n' "$log" >&2
    else
        cat "$log" >&2
        printf '  setup failed; the log above is also in %s\n' "$log" >&2
    fi
    exit 1
}
NO_NETWORK='name resolution|name or service not known|failed to establish a new connection|network is unreachable|dns error'
NO_NETWORK="$NO_NETWORK|error sending request|connection refused|could not connect|connecttimeout|no route to host|from versions: none"
"${PYTHON:-python3}" - <<'PY' || exit 1
import importlib.util, sys
if sys.version_info < (3, 11):
    sys.exit(f"  setup: Spotter needs Python 3.11 or newer, this is {sys.version.split()[0]}; set PYTHON=/path/to/python3.11")
if importlib.util.find_spec("ensurepip") is None:
    sys.exit("  setup: this Python cannot make virtual environments; on Debian and Ubuntu: apt install python3-venv")
PY
# What an interrupted setup left behind is made again: an environment without pip, a uv that does not run, packages that
# were half written (.installing is there while packages are written).
if [ -e .venv ] && ! .venv/bin/python -m pip --version >/dev/null 2>&1; then rm -rf .venv; fi
[ -e .venv ] || step "creating .venv" "${PYTHON:-python3}" -m venv .venv
[ "$(.venv/bin/uv --version 2>/dev/null | cut -d' ' -f2)" = "$UV_VERSION" ] \
    || step "installing uv $UV_VERSION" .venv/bin/python -m pip install --quiet --force-reinstall "uv==$UV_VERSION"
again=()
if [ -e .venv/.installing ]; then again=(--reinstall); fi
touch .venv/.installing
step "installing spotter[$EXTRAS] (about a minute the first time)" \
    .venv/bin/uv pip install --python .venv/bin/python --compile-bytecode "${again[@]}" -c constraints.txt -e ".[$EXTRAS]"
rm .venv/.installing
# So that the first start is no slower than the others, and so are all where Python may not write.
step "compiling Spotter's own modules" .venv/bin/python -m compileall -q common services spotter_client spotter_sim spotter_tools
case ",$EXTRAS," in *,all,* | *,infra-lidar,*)
    step "compiling the lidar's kernels for this processor (once)" .venv/bin/python -m services.infra_lidar.warm_up ;;
esac
touch .venv/.ready
printf '  setup: ready\n' >&2
