#compdef dfr-cluster dvrk_simulator guard hardware line_tracking pusher study video_frames
# Completion in zsh for each program of dfr, installed as _PROGRAM. The candidates come from the
# program's --help.
_dfr_complete() {
  local help word
  local -a given names
  help=$($words[1] --help 2>/dev/null) || return
  for word in ${words[2,CURRENT-1]}; do
    if [[ -n ${(M)${(f)"$(_dfr_subcommands $help)"}:#$word} ]]; then
      given+=($word)
      help=$($words[1] $given --help 2>/dev/null) || return
    fi
  done
  if [[ $PREFIX == -* ]]; then
    names=(${(f)"$(awk '/^  -/ { split($1, n, ","); for (i in n) { sub(/[=:].*/, "", n[i]); print n[i] } }' <<<$help)"})
    compadd -a names
  else
    names=(${(f)"$(_dfr_subcommands $help)"})
    compadd -a names || _files
  fi
}

# Prints the first word of each entry in the list under "Subcommands:".
_dfr_subcommands() {
  awk '/^[A-Z][A-Za-z ]*:$/ { inside = ($0 == "Subcommands:") } inside && /^  [^ ]/ { print $1 }' <<<$1
}

_dfr_complete "$@"
