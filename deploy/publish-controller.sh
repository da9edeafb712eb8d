#!/usr/bin/env bash
# Bring a signed controller to a rig, for `make deploy`: deploy/publish-controller.sh BIN
# Reads CONTROLLER and RIG, and, where they are set, HOST, CONFIG and SHADOW, from the environment.
# Without HOST over the bus that CONFIG names; with it through ssh, on the rig itself, where CONFIG then lies as well.
# Ends with 0 when the rig has taken it, with 2 when the file or the rig says no, with 1 when nobody answers.
set -euo pipefail
bin=$1
usage='make deploy CONTROLLER=file RIG=name [HOST=user@host] [CONFIG=flora.toml] [SHADOW=ticks]'

[ -n "${CONTROLLER:-}" ] || { echo "make deploy: CONTROLLER is not given; $usage" >&2; exit 2; }
[ -n "${RIG:-}" ] || { echo "make deploy: RIG is not given; $usage" >&2; exit 2; }

options=(--rig "$RIG" --shadow "${SHADOW:-0}")
[ -z "${CONFIG:-}" ] || options+=(--config "$CONFIG")

if [ -z "${HOST:-}" ]; then
    exec "$bin/flora-lab" publish "$CONTROLLER" "${options[@]}"
fi

# What is no controller file at all need not travel.
"$bin/flora-controller" check "$CONTROLLER" >/dev/null
# The file goes through standard input: nothing is left on the rig, whenever the line breaks.
remote=$(printf '%q ' flora-controller offer - --name "$(basename "$CONTROLLER")" "${options[@]}")
status=0
ssh -o BatchMode=yes -- "$HOST" "PATH=/opt/flora/current/bin:\$PATH $remote" <"$CONTROLLER" || status=$?
if [ "$status" = 255 ]; then
    echo "make deploy: no connection to $HOST" >&2
    exit 1
fi
exit "$status"
