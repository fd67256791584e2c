#!/usr/bin/env bash
# Installs msp-range as a service on 64-bit Debian, Ubuntu and Raspberry Pi OS; --help lists the options.
# Running it again changes nothing that is as it should be, and never overwrites a file that you have edited.
set -euo pipefail
umask 022  # the service's user reads what root installs

readonly OPT=/opt/msp-range          # programs: one environment per installation, `venv` points to the one in use
readonly ETC=/etc/msp-range          # airframe.yaml
readonly STATE=/var/lib/msp-range    # recordings
readonly SUMS=$OPT/installed.sha256  # what this script wrote, to tell an edited file from an old one
readonly COMMAND=/usr/local/bin/msp-range
readonly UNIT=/etc/systemd/system/msp-range.service
readonly WEB_UNIT=/etc/systemd/system/msp-range-web.service
readonly RULES=/etc/udev/rules.d/70-msp-range.rules
readonly MODULES=/etc/modules-load.d/msp-range.conf
SOURCE=$(cd "$(dirname "${BASH_SOURCE[0]}")" && pwd)
readonly SOURCE
readonly NEEDED_MB=700               # free disk: an installation has 300 MB, and an upgrade keeps the old one meanwhile

usage() {
    cat <<HELP
usage: sudo ./install.sh [--airframe NAME|FILE] [--no-web|--web-on-network] [--upgrade] [--dry-run]
       sudo ./install.sh --uninstall [--purge] [--dry-run]

Installs msp-range as a service: programs in $OPT, the airframe file in $ETC, recordings in $STATE.

  --airframe NAME|FILE  start from this example of configs/ (such as quad_pallet), or from this file; otherwise it asks
                        a few questions about the vehicle. An airframe file that exists is kept
  --no-web              without the web page (port 8642 of this computer); an upgrade keeps that choice
  --web-on-network      other devices in the same network reach the page, by an address with a token: msp-range web on
  --upgrade             replace the programs of an installation; configuration and recordings stay
  --uninstall           remove programs and service; configuration and recordings stay
  --purge               with --uninstall: remove configuration, recordings and the user msp-range too
  --dry-run             print what would be done, and change nothing
  --help                print this

Exit codes: 0 done, 1 something failed, 2 wrong command line, 3 this computer or a file cannot be used.
HELP
}

say() { printf '%s\n' "$*"; }
refuse() { printf 'install.sh: %s\n' "$1" >&2; exit "${2:-3}"; }
# Everything that changes the computer goes through this.
run() {
    if [ "$DRY_RUN" ]; then say "would run: $*"; else "$@"; fi
}
examples() { (cd "$SOURCE/configs" && printf '%s\n' *.yaml | sed 's/\.yaml$//'); }
has_systemd() { [ -d /run/systemd/system ]; }

AIRFRAME='' UPGRADE='' NO_WEB='' ON_NETWORK='' UNINSTALL='' PURGE='' DRY_RUN=''
while [ $# -gt 0 ]; do
    case $1 in
        --airframe) [ $# -ge 2 ] || refuse "--airframe: expected a name or a file" 2; AIRFRAME=$2; shift ;;
        --airframe=*) AIRFRAME=${1#*=} ;;
        --no-web) NO_WEB=1 ;;
        --web-on-network) ON_NETWORK=1 ;;
        --upgrade) UPGRADE=1 ;;
        --uninstall) UNINSTALL=1 ;;
        --purge) PURGE=1 ;;
        --dry-run) DRY_RUN=1 ;;
        --help | -h) usage; exit 0 ;;
        *) usage >&2; refuse "unknown option $1" 2 ;;
    esac
    shift
done
[ -z "$PURGE" ] || [ "$UNINSTALL" ] || refuse "--purge goes with --uninstall" 2
[ -z "$UNINSTALL" ] || [ -z "$UPGRADE$AIRFRAME$NO_WEB$ON_NETWORK" ] || refuse "--uninstall goes with --purge and --dry-run only" 2
[ -z "$NO_WEB" ] || [ -z "$ON_NETWORK" ] || refuse "--no-web and --web-on-network: give one of them" 2

check_computer() {
    [ "$(id -u)" = 0 ] || [ "$DRY_RUN" ] || refuse "needs root: sudo ./install.sh"
    command -v apt-get >/dev/null || refuse "needs Debian, Ubuntu or Raspberry Pi OS: no apt-get found"
    [ "$(getconf LONG_BIT)" = 64 ] || refuse "needs a 64-bit system; this one has $(getconf LONG_BIT) bits"
    local free_mb
    free_mb=$(df -Pm /opt | awk 'NR == 2 { print $4 }')
    [ "$free_mb" -ge $NEEDED_MB ] || refuse "needs $NEEDED_MB MB free in /opt; found $free_mb MB"
}

check_python() {
    if ! python3 -c 'import ensurepip, venv' 2>/dev/null; then
        say "Installing Debian's python3-venv"
        run apt-get install -y -qq --no-install-recommends python3-venv ||
            { run apt-get update -qq; run apt-get install -y -qq --no-install-recommends python3-venv; }
    fi
    [ "$DRY_RUN" ] && ! command -v python3 >/dev/null && return
    python3 -c 'import sys; sys.exit(sys.version_info < (3, 11))' ||
        refuse "needs Python 3.11 or later (Debian 12, Ubuntu 24.04); found $(python3 --version)"
}

# Before anything is changed: is it known which airframe file is meant, or is there a person to ask?
check_airframe() {
    [ -e "$ETC/airframe.yaml" ] && { [ -z "$AIRFRAME" ] || say "$ETC/airframe.yaml is kept; --airframe is not used"; return; }
    if [ -z "$AIRFRAME" ]; then
        [ -t 0 ] || refuse "which airframe? Name an example or a file: --airframe NAME, one of: $(examples | xargs)" 2
    elif [ ! -f "$AIRFRAME" ]; then
        [ -f "$SOURCE/configs/${AIRFRAME%.yaml}.yaml" ] ||
            refuse "--airframe $AIRFRAME: neither a file nor an example; the examples: $(examples | xargs)" 2
        AIRFRAME=$SOURCE/configs/${AIRFRAME%.yaml}.yaml
    fi
}

make_user() {
    # Debian makes the group i2c only with i2c-tools, and the group dialout always.
    getent group i2c >/dev/null || run groupadd --system i2c
    id msp-range >/dev/null 2>&1 ||
        run useradd --system --user-group --home-dir "$STATE" --no-create-home --shell /usr/sbin/nologin msp-range
    run usermod --append --groups i2c,dialout msp-range
    # `msp-range doctor` and `scan` are for the person who installs it, too; it counts from the next login on.
    [ -z "${SUDO_USER:-}" ] || [ "$SUDO_USER" = root ] || run usermod --append --groups i2c,dialout "$SUDO_USER"
}

# Sensor models that come with the program, those next to a file of one's own, and the airframe file.
copy_configuration() {
    mkdir -p "$1/sensors"
    cp "$SOURCE"/configs/sensors/*.yaml "$(dirname "$AIRFRAME")"/sensors/*.yaml "$1/sensors" 2>/dev/null || true
    cp "$AIRFRAME" "$1/airframe.yaml"
}

# The environment is complete before `venv` points to it: an upgrade that fails leaves the old one as it was.
install_programs() {
    NEW=$OPT/venv-$(date -u +%Y%m%dT%H%M%S)
    OLD=$(readlink "$OPT/venv" 2>/dev/null || true)
    say "Installing the programs into $NEW"
    [ "$DRY_RUN" ] && { say "would run: python3 -m venv, pip install $SOURCE"; return; }
    # A copy: the build leaves no files of root's in the clone, and finds none of an earlier one there.
    COPY=$(mktemp -d) UNUSED=$NEW
    trap 'rm -rf "$COPY" "$UNUSED"; rmdir "$OPT" 2>/dev/null || true' EXIT
    (cd "$SOURCE" && cp -a pyproject.toml README.md LICENSE bin configs msp_range sim "$COPY")
    python3 -m venv "$NEW"
    # Ready packages of the versions that were tested, checked by their hashes: as root, nothing else is downloaded.
    local pip=("$NEW/bin/python" -m pip --quiet --disable-pip-version-check install --no-cache-dir --compile)
    "${pip[@]}" --require-hashes --only-binary :all: -r "$SOURCE/requirements.lock"
    "${pip[@]}" --no-deps --no-index --no-build-isolation "$COPY"
    cp "$SOURCE"/requirements-*.lock "$NEW"
    local airframe=$ETC/airframe.yaml
    if [ ! -e "$airframe" ]; then
        if [ -z "$AIRFRAME" ]; then
            say "What is most like your vehicle? The file $airframe can be changed afterwards."
            "$NEW/bin/msp-range" airframes --into "$COPY/chosen" >/dev/null
            AIRFRAME=$COPY/chosen/airframe.yaml
        fi
        airframe=$COPY/etc/airframe.yaml
        copy_configuration "$COPY/etc"
    fi
    { "$NEW/bin/msp-range" extras --airframe "$airframe" && "$NEW/bin/msp-range" check "$airframe"; } >/dev/null ||
        refuse "this version cannot use ${AIRFRAME:-$airframe} (above); nothing was changed"
    UNUSED=''
}

# Copy a file; where it was edited since this script wrote it, put the new one next to it.
put() {
    local from=$1 to=$2
    if [ -e "$to" ] && ! cmp -s "$from" "$to" && ! grep -qxF "$(sha256sum "$to")" "$SUMS" 2>/dev/null; then
        say "$to was edited and is kept; the new one is $to.new"
        to=$to.new
    fi
    run install -D -m 644 "$from" "$to"
    [ "$DRY_RUN" ] || sha256sum "$to" >>"$SUMS"
}

install_files() {
    put "$SOURCE/systemd/msp-range.service" $UNIT
    if [ "$NO_WEB" ]; then remove_web; else put "$SOURCE/systemd/msp-range-web.service" $WEB_UNIT; fi
    put "$SOURCE/systemd/msp-range.rules" $RULES
    put "$SOURCE/systemd/msp-range.modules" $MODULES
    local each
    for each in "$SOURCE"/configs/sensors/*.yaml; do put "$each" "$ETC/sensors/$(basename "$each")"; done
    [ -e "$ETC/airframe.yaml" ] || run copy_configuration "$ETC"
    run install -d -o msp-range -g msp-range "$STATE"
}

remove_web() {
    if has_systemd; then
        run systemctl disable --quiet --now msp-range-web 2>/dev/null || true
    else
        run rm -f /etc/systemd/system/multi-user.target.wants/msp-range-web.service
    fi
    run rm -rf "$WEB_UNIT" "$WEB_UNIT.new" "$WEB_UNIT.d/network.conf"
}

# A unit that was edited, or a drop-in, may still have the page in the bridge's own command line, as before: its port
# is not free then.
has_own_page() { grep -qs -- '^ExecStart=.* --web' $UNIT $UNIT.d/*.conf; }

start_web() {
    [ -z "$NO_WEB" ] || return 0
    if has_own_page; then
        say "The page stays a part of msp-range.service, as --web in it says. Without that option there:"
        say "sudo systemctl enable --now msp-range-web"
        return
    fi
    run systemctl enable --quiet msp-range-web 2>/dev/null || true
    has_systemd || { [ -z "$ON_NETWORK" ] || say "When it runs: sudo msp-range web on"; return 0; }
    run systemctl restart msp-range-web || { say "the page does not start: journalctl -u msp-range-web -n 20"; return; }
    run "$COMMAND" web ${ON_NETWORK:+on} || say "the page is not on the network: sudo msp-range web on"
}

switch_to() {
    run ln -sfn "$(basename "$1")" "$OPT/venv.next"
    run mv -T "$OPT/venv.next" "$OPT/venv"
    run ln -sfn "$OPT/venv/bin/msp-range" "$COMMAND"
}

load_rules() {
    has_systemd || return 0
    run systemctl daemon-reload
    # A container has no modules and no udev.
    while read -r module; do
        case $module in '' | '#'*) ;; *) run modprobe -q "$module" 2>/dev/null || true ;; esac
    done <"$SOURCE/systemd/msp-range.modules"
    if run udevadm control --reload 2>/dev/null; then
        run udevadm trigger --subsystem-match=i2c-dev --subsystem-match=tty || true
    fi
}

# It has the bus and the port for itself before the start; after an upgrade it asks the bridge that runs.
find_faults() {
    say "Looking for what is wrong: msp-range doctor"
    local all code=0
    all=$(runuser -u msp-range -- "$OPT/venv/bin/msp-range" doctor "$ETC/airframe.yaml" 2>&1) || code=$?
    FAULTS=$(awk '/^(right|wrong|unknown) / { is_wrong = /^wrong/ } /^$/ { is_wrong = 0 } is_wrong' <<<"$all")
    [ $code = 0 ] || [ "$FAULTS" ] || FAULTS=$all  # doctor itself failed
}

report() {
    if [ -z "$FAULTS" ]; then
        say "msp-range doctor finds nothing wrong."
    else
        say "Wrong now, and what to do ('msp-range doctor' shows all that it looked at):"
        say "$FAULTS"
    fi
}

start() {
    if ! has_systemd; then
        run systemctl enable msp-range 2>/dev/null || true
        say "systemd is not running here: the service starts at the next boot"
        return
    fi
    [ "$DRY_RUN" ] || systemctl -q is-active msp-range || find_faults
    run systemctl enable --quiet msp-range
    if run systemctl restart msp-range; then
        [ "$DRY_RUN" ] || [ "${FAULTS+examined}" ] || find_faults
        return
    fi
    systemctl --no-pager --lines 20 status msp-range || true
    if [ "$OLD" ] && [ -d "$OPT/$OLD" ]; then
        switch_to "$OPT/$OLD"
        systemctl restart msp-range || true
        rm -rf "$NEW"
        refuse "the new version does not start (above); the old one is back" 1
    fi
    start_web  # it says why, too
    [ -z "${FAULTS-}" ] || report
    refuse "the service does not start (above)" 1
}

remove_old() {
    [ "$DRY_RUN" ] && return
    local each
    for each in "$OPT"/venv-*; do [ "$each" = "$NEW" ] || rm -rf "$each"; done
}

install_all() {
    [ ! -e $UNIT ] || [ -e $WEB_UNIT ] || [ "$ON_NETWORK" ] || has_own_page || NO_WEB=1
    [ -z "$UPGRADE" ] || [ -e "$OPT/venv" ] || refuse "nothing is installed in $OPT; leave out --upgrade"
    check_airframe
    check_python
    install_programs
    make_user
    install_files
    switch_to "$NEW"
    load_rules
    start
    remove_old
    say ""
    start_web
    say "Airframe file: $ETC/airframe.yaml (after a change: msp-range check, then sudo systemctl reload msp-range)"
    [ -z "${FAULTS+examined}" ] || report
    if [ "${FAULTS-}" ]; then
        say "Next, when that is done: msp-range doctor"
    elif [ -e "$ETC/airframe.commission.json" ]; then
        say "Next: msp-range status"
    else
        say "Next, with the propellers off: sudo systemctl stop msp-range && sudo msp-range commission --phone"
        say "and when it is through: sudo systemctl start msp-range"
    fi
}

remove_all() {
    remove_web
    if has_systemd; then
        run systemctl disable --quiet --now msp-range 2>/dev/null || true
    else
        run rm -f /etc/systemd/system/multi-user.target.wants/msp-range.service
    fi
    run rm -rf "$UNIT" "$UNIT.new" "$RULES" "$RULES.new" "$MODULES" "$MODULES.new" "$OPT"
    [ "$(readlink $COMMAND 2>/dev/null)" != "$OPT/venv/bin/msp-range" ] || run rm -f $COMMAND
    if has_systemd; then
        run systemctl daemon-reload
        run udevadm control --reload 2>/dev/null || true
    fi
    if [ "$PURGE" ]; then
        run rm -rf "$ETC" "$STATE" "$UNIT.d" "$WEB_UNIT.d"
        ! id msp-range >/dev/null 2>&1 || run userdel msp-range
        say "msp-range is removed, with its configuration and recordings"
    else
        say "msp-range is removed; $ETC and $STATE are kept (--purge removes them)"
    fi
}

check_computer
if [ "$UNINSTALL" ]; then remove_all; else install_all; fi
