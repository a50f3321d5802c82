# Completion in fish for each program of dfr, installed as PROGRAM.fish. The candidates come from
# the program's --help.
function __dfr_complete --argument-names program
    set -l help ($program --help 2>/dev/null)
    set -l commands
    for word in (commandline -opc)[2..-1]
        if contains -- $word (__dfr_subcommands $help)
            set -a commands $word
            set help ($program $commands --help 2>/dev/null)
        end
    end
    __dfr_subcommands $help
    printf '%s\n' $help | string match -rg '^  (-\S+)' | string split , | string replace -r '[=:].*' ''
end

# Prints the first word of each entry in the list under "Subcommands:".
function __dfr_subcommands
    printf '%s\n' $argv | awk '/^[A-Z][A-Za-z ]*:$/ { inside = ($0 == "Subcommands:") } inside && /^  [^ ]/ { print $1 }'
end

set -l program (basename (status filename) .fish)
complete -c $program -a "(__dfr_complete $program)"
