# Sourced by quickstart and test: checks what the build needs and installs what is missing.
#
# Sets `features` to the cargo arguments that build the program on this machine: those that take OpenCV in where it can be used, none where
# it cannot.

say() { printf '\n== %s\n' "$*" >&2; }

# Whether somebody is there to be asked.
can_ask() { [ "${CI:-}" != true ] && [ -t 0 ] && [ -t 2 ]; }

# What to put before a command that needs root: nothing where we are root, else sudo if somebody agrees to it.
root_prefix() {
  [ "$(id -u)" = 0 ] && return 0
  command -v sudo >/dev/null && can_ask || return 1
  read -r -p "Use sudo to install them? [y/N] " answer
  case "$answer" in [yY]*) echo sudo ;; *) return 1 ;; esac
}

# Which of these Debian packages are not installed.
missing_packages() {
  for package in "$@"; do
    dpkg-query -W -f='${db:Status-Status}' "$package" 2>/dev/null | grep -qx installed || echo "$package"
  done
}

# Installs those Debian packages that are missing; fails where it cannot.
ensure_packages() {
  local missing prefix
  missing=$(missing_packages "$@")
  [ -z "$missing" ] && return 0
  say "Missing packages:" $missing
  prefix=$(root_prefix) || return 1
  $prefix apt-get update -qq >&2 || true
  $prefix env DEBIAN_FRONTEND=noninteractive apt-get install -y -qq --no-install-recommends $missing >&2
}

has_compiler() { command -v cc >/dev/null; }

# What `opencv` needs: its headers, and libclang to read them with.
has_opencv() {
  if command -v apt-get >/dev/null; then
    [ -z "$(missing_packages libopencv-dev clang libclang-dev pkg-config)" ]
  else
    command -v pkg-config >/dev/null && pkg-config --exists opencv4 && command -v clang >/dev/null
  fi
}

prepare() {
  if ! command -v cargo >/dev/null; then
    say "Rust is missing. Install it from https://rustup.rs and start this again."
    exit 1
  fi
  if ! has_compiler && ! { command -v apt-get >/dev/null && ensure_packages gcc libc6-dev; }; then
    say "A C compiler (cc) is missing and could not be installed. Install gcc and start this again."
    exit 1
  fi
  if command -v apt-get >/dev/null && ! python3 -c 'import ensurepip' 2>/dev/null; then
    ensure_packages python3-venv || true
  fi
  if ! has_opencv && command -v apt-get >/dev/null; then
    ensure_packages libopencv-dev clang libclang-dev pkg-config g++ || true
  fi
  if has_opencv; then
    features="--features opencv"
  else
    features=""
    say "OpenCV is not here and could not be installed (Debian: libopencv-dev clang libclang-dev pkg-config)."
    echo "Going on without it: no video files, camera devices and lens calibration; all else works." >&2
  fi
}
