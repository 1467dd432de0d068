#!/usr/bin/env bash
# Installs Aritra as a systemd service from this checkout; may be run again at any time. See docs/service.md.
set -euo pipefail
umask 022
unset CDPATH # with it, cd may go elsewhere, and print where

usage() {
    cat <<'END'
usage: deploy/install.sh [--dry-run] [--uninstall] [--python PYTHON] [--root DIR]

  --dry-run        print what would be done, change nothing
  --uninstall      stop and remove service, udev rules and program; keep configuration, logs and user
  --python PYTHON  Python 3.11 or newer (default: the first of python3, python3.13, python3.12, python3.11 that is)
  --root DIR       install below DIR, without user, systemctl and udevadm; needs no root

Program /opt/aritra, configuration /etc/aritra, logs /var/lib/aritra. Configuration that is there stays as it is.
Nothing is started. Exit codes: 0 done, 1 failed, 2 cannot be done here (the message says why).
END
}

die() {
    echo "install.sh: $*" >&2
    exit 2
}

# --- what is asked for ------------------------------------------------------------------------------

dry_run='' uninstall='' python='' named='' root=''
while [ $# -gt 0 ]; do
    case $1 in
        --dry-run) dry_run=yes ;;
        --uninstall) uninstall=yes ;;
        --python) [ $# -gt 1 ] || die "--python needs a program"; python=$2 named=yes; shift ;;
        --root) [ $# -gt 1 ] || die "--root needs a folder"; root=$2; shift ;;
        -h | --help) usage; exit 0 ;;
        *) usage >&2; die "unknown option $1" ;;
    esac
    shift
done

source=$(cd "$(dirname "${BASH_SOURCE[0]}")/.." && pwd)
case $root in '' | /*) ;; *) root=$PWD/$root ;; esac
program=$root/opt/aritra
config=$root/etc/aritra
state=$root/var/lib/aritra
unit=$root/etc/systemd/system/aritra.service
rules=$root/etc/udev/rules.d/70-aritra.rules

# --- small steps: each does nothing where it is done already ----------------------------------------

run() {
    echo "+ $*"
    [ -n "$dry_run" ] || "$@"
}

on_system() { # only where this is the running system, not a folder
    [ -n "$root" ] || run "$@"
}

folder() { # folder MODE OWNER:GROUP PATH
    [ -d "$3" ] || run mkdir -p "$3"
    on_system chown "$2" "$3"
    [ "$(stat -c %a "$3" 2>/dev/null)" = "$1" ] || run chmod "$1" "$3"
}

put() { # put SOURCE TARGET: the newest version, always
    cmp -s "$1" "$2" || run install -D -m 0644 "$1" "$2"
}

tool() { # tool SOURCE TARGET: as put, and it may be run
    cmp -s "$1" "$2" || run install -D -m 0755 "$1" "$2"
}

offer() { # offer SOURCE TARGET: only where there is none, or an empty one; what a person edited stays
    if [ -s "$2" ]; then
        cmp -s "$1" "$2" || echo "kept: $2"
    else # whole or not at all, whatever comes between: what is there is never written again
        run install -D -m 0640 "$1" "$2.new"
        run sync "$2.new"
        run mv "$2.new" "$2"
    fi
}

base() { # base PYTHON: which installation it is, or nothing
    "$1" -c 'import sys; print(sys.base_prefix, sys.version)' 2>/dev/null || true
}

sound() { # sound STAMP: is the environment made to its end, and does its Python find what is in it?
    [ -e "$1" ] && "$program/bin/python" -m pip --version >/dev/null 2>&1
}

find_python() { # the first that serves; where none does, what keeps the first from it
    local candidate place why='' candidates=("$python")
    [ -n "$named" ] || candidates=(python3 python3.13 python3.12 python3.11)
    for candidate in "${candidates[@]}"; do
        "$candidate" -c 'import sys; sys.exit(sys.version_info < (3, 11))' 2>/dev/null || continue
        if ! "$candidate" -c 'import ensurepip, venv' 2>/dev/null; then
            why=${why:-"$candidate has no venv: install its venv package (Debian, Ubuntu: $candidate-venv)"}
            continue
        fi
        place=$("$candidate" -c 'import sys; print(sys.base_prefix)')
        case $root:$place in
            :/home/* | :/root/*)
                why=${why:-"$candidate lies in $place, which the service may not read; take one from /usr or /opt: --python"}
                continue ;;
        esac
        python=$candidate
        return
    done
    die "${why:-"no Python 3.11 or newer found${named:+: $python is none}. Ubuntu 22.04, JetPack 6: apt install python3.11 python3.11-venv;
elsewhere: UV_PYTHON_INSTALL_DIR=/opt/python uv python install 3.12, and say --python (docs/service.md)"}"
}

# --- the three jobs ---------------------------------------------------------------------------------

install_program() {
    # The stamp says which packages are in the environment; without, it was not made to its end; empty: not known.
    local lock=$source/requirements.lock stamp=$program/requirements.sha256 sum there
    sum=$(sha256sum <"$lock")
    there=$(cat "$stamp" 2>/dev/null || true)
    [ -z "$named" ] || find_python
    if ! sound "$stamp" || { [ -n "$named" ] && [ "$(base "$program/bin/python")" != "$(base "$python")" ]; }; then
        [ -n "$named" ] || find_python
        there=''
        [ ! -e "$stamp" ] || run rm "$stamp"
        run "$python" -m venv --clear "$program"
    fi
    if [ "$there" != "$sum" ]; then
        [ -n "$dry_run" ] || : >"$stamp"
        run "$program/bin/python" -m pip install --quiet --disable-pip-version-check --require-hashes -r "$lock"
        [ -n "$dry_run" ] || echo "$sum" >"$stamp"
    fi
    run "$program/bin/python" -m pip install --quiet --disable-pip-version-check --no-deps --no-build-isolation \
        --force-reinstall "$source"
    put "$source/docs/service.md" "$program/share/doc/aritra/service.md"
    tool "$source/deploy/zenoh/make-certificates" "$program/share/aritra/zenoh/make-certificates"
    tool "$source/deploy/zenoh/router.py" "$program/share/aritra/zenoh/router.py"
}

offer_configuration() {
    local file
    offer "$source/deploy/on-board.toml" "$config/aritra.toml"
    while IFS= read -r file; do
        offer "$source/deploy/$file" "$config/$file"
    done < <(cd "$source/deploy" && find boats sites missions excitations zenoh -type f ! -name '*.py' ! -name make-certificates | sort)
}

install_service() {
    if [ -z "$root" ]; then
        getent group aritra >/dev/null || run groupadd --system aritra
        getent passwd aritra >/dev/null ||
            run useradd --system --gid aritra --home-dir /var/lib/aritra --shell /usr/sbin/nologin aritra
        # As the unit gives it, for runs by hand: serial devices, and a folder for logs.
        id -nG aritra 2>/dev/null | grep -qw dialout || run usermod -aG dialout aritra
    fi
    folder 750 aritra:aritra "$state"
    folder 750 root:aritra "$config"
    if [ -n "$dry_run" ] && [ -d "$config" ] && [ ! -x "$config" ]; then
        echo "cannot look into $config: what would be written there, sudo $0 --dry-run tells"
    else
        offer_configuration
    fi
    on_system chgrp -R aritra "$config"
    run chmod -R g-w,o= "$config"
    run find "$config" -user root ! -type l ! -name '*.key' -exec chmod g+rX {} +
    # Secrets of links and orders (docs/ground-station.md, docs/telemetry.md): who may read them, may steer.
    run find "$config" -type f -name '*.key' -exec chmod 600 {} +
    on_system find "$config" -type f -name '*.key' -exec chown aritra {} +
    put "$source/deploy/aritra.service" "$unit"
    [ ! -d "$unit.d" ] || echo "kept: $unit.d, which changes the unit: systemctl cat aritra"
    put "$source/deploy/udev/70-aritra.rules" "$rules"
    reload
}

remove() {
    local kept=("$config" "$state") more
    for more in "$unit.d" "$root/var/cache/aritra"; do
        [ ! -e "$more" ] || kept+=("$more")
    done
    [ ! -e "$unit" ] || on_system systemctl disable --now aritra.service
    [ ! -e "$unit" ] || run rm -f "$unit"
    [ ! -e "$rules" ] || run rm -f "$rules"
    [ ! -f "$program/pyvenv.cfg" ] || run rm -rf "$program"
    reload
    echo "kept: $(printf '%s, ' "${kept[@]}")user and group aritra. To remove them, too:"
    echo "  rm -r ${kept[*]}; userdel aritra"
}

reload() {
    on_system systemctl daemon-reload
    on_system udevadm control --reload
    on_system udevadm trigger --subsystem-match=tty --subsystem-match=usb
}

# --- begin ------------------------------------------------------------------------------------------

if [ -z "$root" ]; then
    [ -n "$dry_run" ] || [ "$(id -u)" = 0 ] || die "needs root: sudo $0"
    command -v systemctl >/dev/null || die "no systemd here: systemctl is missing"
fi
if [ -n "$uninstall" ]; then
    [ -e "$unit" ] || [ -e "$rules" ] || [ -e "$program" ] || die "nothing to remove: there is no $unit, no $program"
    remove
    exit 0
fi
if [ -z "$root" ]; then
    case $(systemctl is-active aritra.service || true) in
        active | activating | deactivating | reloading)
            die "aritra.service is running; bring the boat to rest, then: sudo systemctl stop aritra" ;;
    esac
fi
install_program
install_service
if [ -n "$dry_run" ]; then
    echo "dry run: nothing was changed"
    exit 0
fi
cat <<END
installed. Next:
  1. edit $config/aritra.toml and the files beside it: your boat, your anchors, your mission
  2. see /dev/aritra-autopilot and /dev/aritra-uwb after plugging in
  3. sudo systemctl enable --now aritra     (starts idle: neutral, until a person starts the mission)
END
