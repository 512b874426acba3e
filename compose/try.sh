#!/usr/bin/env bash
# Builds and runs the demo of demo.yml with a real Docker daemon, says what came up, and takes it down again.
#   compose/try.sh                          with `docker compose`, or docker-compose 1.29 and newer
#   BASE=registry.example/python:3.11 compose/try.sh
#   TRY_IMAGE=1 compose/try.sh              with the image spotter:demo that is there, not built again
# Exit code 0: three healthy containers, the page answers with its token and not without, and not under a foreign name.
set -euo pipefail
cd "$(dirname "$0")"
docker info >/dev/null || { echo "try: no Docker daemon answers" >&2; exit 2; }
if docker compose version >/dev/null 2>&1; then compose=(docker compose); else compose=(docker-compose); fi
"${compose[@]}" version
export SPOTTER_DASHBOARD_TOKEN="${SPOTTER_DASHBOARD_TOKEN:-try-$$}" SPOTTER_PORT="${SPOTTER_PORT:-8080}"
run() { "${compose[@]}" -p spotter-try -f demo.yml "$@"; }
page() { curl -s -o /dev/null -w '%{http_code}' --max-time 5 "$@" || true; }
expect() { # expect WHAT WANTED GOT
    printf '  %-40s %s\n' "$1" "$3"
    [ "$2" = "$3" ] || { echo "try: $1: expected $2" >&2; run logs --tail 30 >&2; exit 1; }
}
trap 'run down -t 5' EXIT
[ -n "${TRY_IMAGE:-}" ] || run build ${BASE:+--build-arg "BASE=$BASE"}
run up -d
url="http://127.0.0.1:$SPOTTER_PORT/"
deadline=$((SECONDS + ${TRY_SECONDS:-180}))
for host in pi0 jetson0 infra0; do
    state=""
    while [ "$state" != healthy ] && [ "$SECONDS" -lt "$deadline" ]; do
        state=$(docker inspect -f '{{.State.Health.Status}}' "$(run ps -q "$host")")
        [ "$state" = healthy ] || sleep 1
    done
    expect "$host" healthy "$state"
done
expect "page with its token" 200 "$(page "$url?token=$SPOTTER_DASHBOARD_TOKEN")"
expect "page without its token" 401 "$(page "$url")"
expect "page under a foreign name" 421 "$(page -H 'Host: evil.example' "$url?token=$SPOTTER_DASHBOARD_TOKEN")"
