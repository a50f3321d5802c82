# Completion in bash for each program of dfr, installed under the program's name. The candidates
# come from the program's --help.
_dfr_complete() {
  local current=${COMP_WORDS[COMP_CWORD]} words=() word help
  help=$("$1" --help 2>/dev/null) || return
  for word in "${COMP_WORDS[@]:1:COMP_CWORD-1}"; do
    if _dfr_subcommands "$help" | grep -qxF -- "$word"; then
      words+=("$word")
      help=$("$1" "${words[@]}" --help 2>/dev/null) || return
    fi
  done
  COMPREPLY=()
  if [[ $current == -* ]]; then
    mapfile -t COMPREPLY < <(compgen -W "$(_dfr_options "$help")" -- "$current")
  else
    mapfile -t COMPREPLY < <(compgen -W "$(_dfr_subcommands "$help")" -- "$current")
    [[ ${#COMPREPLY[@]} -gt 0 ]] || compopt -o default 2>/dev/null  # names of files
  fi
}

# Prints the first word of each entry in the list under "Subcommands:".
_dfr_subcommands() {
  awk '/^[A-Z][A-Za-z ]*:$/ { inside = ($0 == "Subcommands:") } inside && /^  [^ ]/ { print $1 }' <<<"$1"
}

# Prints each -x and --long at the beginning of an entry of a list.
_dfr_options() {
  awk '/^  -/ { split($1, names, ","); for (i in names) { sub(/[=:].*/, "", names[i]); print names[i] } }' <<<"$1"
}

complete -F _dfr_complete "${BASH_SOURCE[0]##*/}"
