#!/bin/sh
# Builds .venv from a Python alone, with what `make run` needs and what is named: extras or groups of pyproject.toml.
# What is there stays, and nothing is done where all is there. PYTHON names the Python.
set -u
cd "$(dirname "$0")/.." || exit 1
# An inherited virtual environment or uv setting must not decide what is built here.
unset VIRTUAL_ENV UV_PYTHON UV_PROJECT_ENVIRONMENT UV_PROJECT PYTHONPATH
export UV_PYTHON_DOWNLOADS=never
python=${PYTHON:-python3}
has=.venv/.has    # A file for each set that is installed, as old as its installation.
unfinished=.setup # While a set-up is at work its number; what was killed leaves it behind.
log=$(mktemp) || exit 1
ticker=

say() { echo "dream: $*" >&2; }
end() { # Quietly: whoever pressed Ctrl-C knows.
    [ -z "$ticker" ] || kill "$ticker" 2>/dev/null
    rm -f "$log"
}
trap end EXIT
trap 'exit 130' INT
trap 'exit 143' TERM HUP

names_under() { # Of a table of pyproject.toml.
    sed -n "/^\[$1\]/,/^\[/s/^\([a-z][a-z-]*\) = .*/\1/p" pyproject.toml
}
is_there() {
    [ -x .venv/bin/python ] || return 1
    for set in base "$@"; do
        [ -f "$has/$set" ] || return 1
        [ ! pyproject.toml -nt "$has/$set" ] && [ ! uv.lock -nt "$has/$set" ] || return 1
    done
}
ticking() { # WORDS COMMAND...: says at once what it does, and every 10 s that it still does.
    words=$1
    shift
    say "$words ..."
    # A sleep that outlives all this must keep no pipe open that the caller waits on.
    (
        seconds=0
        while sleep 10 >/dev/null 2>&1 && kill -0 $$ 2>/dev/null; do
            seconds=$((seconds + 10))
            say "$words, $seconds s"
        done
    ) >/dev/null &
    ticker=$!
    "$@" 2>"$log"
    status=$?
    kill "$ticker" 2>/dev/null
    ticker=
    [ "$status" = 0 ] || cat "$log" >&2
    return "$status"
}
give_up() {
    say "the set-up did not end; the same command takes it up again."
    say "Where no package is found or a certificate is refused, the network has an authority of its own. Say which:"
    say "  export SSL_CERT_FILE=/etc/ssl/certs/ca-certificates.crt   (those that Debian and Ubuntu trust)"
    exit 1
}

extras=$(names_under project.optional-dependencies)
groups=$(names_under dependency-groups)
for set; do
    if ! printf '%s\n' "$extras" "$groups" | grep -qx -e "$set"; then
        say "EXTRAS: expected some of $(echo "$extras" | paste -sd , - | sed 's/,/, /g'), got $set"
        exit 2
    fi
done
is_there "$@" && exit 0

while other=$(cat $unfinished 2>/dev/null) && kill -0 "$other" 2>/dev/null; do
    say "waiting for the set-up of process $other (if that is another program, remove $PWD/$unfinished)"
    sleep 10
done
# Again: the other may just have ended.
is_there "$@" && exit 0
repair=
[ -f $unfinished ] && repair=--reinstall
echo $$ >$unfinished

if ! .tools/bin/python -c '' 2>/dev/null || ! .tools/bin/uv --version >/dev/null 2>&1; then
    if ! "$python" -c 'import sys; sys.exit(sys.version_info < (3, 11))' 2>/dev/null; then
        rm $unfinished
        say "expected Python 3.11 or newer, got $("$python" --version 2>&1). Try: make PYTHON=python3.12 ..."
        exit 1
    fi
    rm -rf .tools
    ticking "setting up: an environment for the installer, uv" "$python" -m venv .tools || give_up
    PIP_CERT=${PIP_CERT:-${SSL_CERT_FILE:-}}
    [ -z "$PIP_CERT" ] || export PIP_CERT
    ticking "setting up: loading uv, some 25 MB" \
        .tools/bin/python -m pip install --quiet --disable-pip-version-check "uv>=0.8,<1" || give_up
fi

sets=base
flags=
for set in $( (printf '%s\n' "$@"; ls $has 2>/dev/null) | sort -u); do
    if printf '%s\n' "$extras" | grep -qx "$set"; then
        flags="$flags --extra $set"
    elif printf '%s\n' "$groups" | grep -qx "$set"; then
        flags="$flags --group $set"
    else
        continue # base, and what pyproject.toml names no more.
    fi
    sets="$sets $set"
done
sync() { # QUIETLY, or an empty word.
    # shellcheck disable=SC2086
    .tools/bin/uv sync $1 --locked --inexact --no-default-groups $flags $repair \
        --python "$(.tools/bin/python -c 'import sys; print(sys._base_executable)')"
}
if [ -t 2 ]; then
    say "setting up: loading and installing packages in .venv ($sets)"
    sync '' || give_up
else
    ticking "setting up: loading and installing packages in .venv ($sets)" sync --quiet || give_up
fi
mkdir -p $has
for set in $sets; do
    : >"$has/$set"
done
rm -f $unfinished
