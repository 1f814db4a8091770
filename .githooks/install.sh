#!/usr/bin/env bash
# Installs a hook that checks commit messages with the commit-msg of this folder. Only in a checkout, and never over
# a hook, or beside a folder of hooks, that is there already.
set -euo pipefail
cd "$(dirname "$0")/.."

checkout=$(git rev-parse --show-toplevel 2>/dev/null) || exit 0
[ "$checkout" = "$(pwd -P)" ] || exit 0  # an unpacked archive in another project
folder=$(git config core.hooksPath || true)
if [ -n "$folder" ]; then
    echo "setup: commit messages are not checked: core.hooksPath is $folder; its commit-msg may call .githooks/commit-msg"
    exit 0
fi
hook=$(git rev-parse --git-path hooks)/commit-msg
if [ -e "$hook" ] || [ -L "$hook" ]; then
    grep -q .githooks/commit-msg "$hook" 2>/dev/null ||
        echo "setup: commit messages are not checked: $hook is another hook; it may call .githooks/commit-msg"
    exit 0
fi
mkdir -p "$(dirname "$hook")"
cat >"$hook" <<'HOOK'
#!/bin/sh
# made by .githooks/install.sh; commits of older versions, without that folder, are not checked
[ ! -x .githooks/commit-msg ] || exec .githooks/commit-msg "$@"
HOOK
chmod +x "$hook"
