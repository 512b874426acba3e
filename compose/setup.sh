#!/usr/bin/env bash
# Makes .venv with the extras named in EXTRAS, from constraints.txt. Quiet; the log is shown when a step fails.
set -euo pipefail
cd "$(dirname "$0")/.."
log=.setup.log
# Trust what this machine trusts (a company's own certificate authority, for example).
if [ -s /etc/ssl/certs/ca-certificates.crt ]; then export UV_SYSTEM_CERTS="${UV_SYSTEM_CERTS:-1}"; fi
: >"$log"
step() {
    printf '  setup: %s ...\n' "$1" >&2
    shift
    "$@" >>"$log" 2>&1 || { cat "$log" >&2; printf '  setup failed; the log above is also in %s\n' "$log" >&2; exit 1; }
}
"${PYTHON:-python3}" - <<'PY' || exit 1
import importlib.util, sys
if sys.version_info < (3, 11):
    sys.exit(f"  setup: Spotter needs Python 3.11 or newer, this is {sys.version.split()[0]}; set PYTHON=/path/to/python3.11")
if importlib.util.find_spec("ensurepip") is None:
    sys.exit("  setup: this Python cannot make virtual environments; on Debian and Ubuntu: apt install python3-venv")
PY
[ -x .venv/bin/python ] || step "creating .venv" "${PYTHON:-python3}" -m venv .venv
[ "$(.venv/bin/uv --version 2>/dev/null | cut -d' ' -f2)" = "$UV_VERSION" ] \
    || step "installing uv $UV_VERSION" .venv/bin/python -m pip install --quiet "uv==$UV_VERSION"
step "installing spotter[$EXTRAS] (about a minute the first time)" \
    .venv/bin/uv pip install --python .venv/bin/python --compile-bytecode -c constraints.txt -e ".[$EXTRAS]"
# So that the first start is no slower than the others, and so are all where Python may not write.
step "compiling Spotter's own modules" .venv/bin/python -m compileall -q common services
case ",$EXTRAS," in *,all,* | *,infra-lidar,*)
    step "compiling the lidar's kernels for this processor (once)" .venv/bin/python -m services.infra_lidar.compile_kernels ;;
esac
touch .venv/.ready
printf '  setup: ready\n' >&2
