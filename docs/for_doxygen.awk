# Converts Markdown for Doxygen 1.9, which does not support GitHub's conventions. Headings get GitHub's
# anchors. Links to sources become references, and links to other files outside the manual become
# text. Mathematics, in $`...`$ and in math fences, becomes Doxygen's formulas.
function base(path) { sub(/.*\//, "", path); sub(/\.md$/, "", path); return path }
function slug(text) {
  text = tolower(text)
  gsub(/[^a-z0-9 _-]/, "", text)
  gsub(/ /, "-", text)
  return text
}
function target(link,   parts) {
  if (link ~ /^[a-z]+:/ || link ~ /\.(png|jpg)$/) return link
  split(link, parts, "#")
  if (link ~ /#/) return "@ref " (parts[1] == "" ? base(FILENAME) : base(parts[1])) "_" parts[2]
  if (link ~ /\.md$/) return link
  if (link ~ /examples\/[a-z_]+\.(cc|py)$/) return "@ref " base(link)
  if (link ~ /examples\/new_app$/) return "@ref new_app/main.cc"
  if (link ~ /^(\.\.\/)?libs$/) return "annotated.html"
  return ""
}
# Escapes @ outside backticks, where Doxygen interprets a name such as @mcap/core as a command.
function unquoted(line,   parts, count, i, out) {
  count = split(line, parts, "`")
  for (i = 1; i <= count; ++i) {
    if (i % 2 == 1) gsub(/@/, "\\@", parts[i])
    out = out (i > 1 ? "`" : "") parts[i]
  }
  return out
}
# Converts bold text that contains code, which Doxygen does not support: **`name` and text**.
function bold(line,   found, out) {
  out = ""
  while (match(line, /\*\*(`[^`]*`|[^*`])+\*\*/)) {
    found = substr(line, RSTART, RLENGTH)
    out = out substr(line, 1, RSTART - 1)
    line = substr(line, RSTART + RLENGTH)
    out = out (found ~ /`/ ? "<b>" substr(found, 3, length(found) - 4) "</b>" : found)
  }
  return out line
}
# Moves the formulas of a line into `formulas`, and leaves numbered marks until the rest is converted.
function hidden(line,   out) {
  out = ""
  count = 0
  while (match(line, /\$`[^`]*`\$/)) {
    formulas[++count] = "\\f$" substr(line, RSTART + 2, RLENGTH - 4) "\\f$"
    out = out substr(line, 1, RSTART - 1) "\001" count "\001"
    line = substr(line, RSTART + RLENGTH)
  }
  return out line
}
function shown(line,   i, at) {
  for (i = 1; i <= count; ++i) {
    at = index(line, "\001" i "\001")
    line = substr(line, 1, at - 1) formulas[i] substr(line, at + length(i) + 2)
  }
  return line
}
/^```math$/ { display = 1; print "\\f["; next }
display && /^```$/ { display = 0; print "\\f]"; next }
display { print; next }
/^ *```/ { fenced = !fenced }
!fenced && /^##+ / {
  title = $0
  sub(/^#+ /, "", title)
  anchor = base(FILENAME) "_" slug(title)
  $0 = $0 " {#" anchor (seen[anchor]++ ? "-" seen[anchor] - 1 : "") "}"
}
!fenced {
  rest = unquoted(bold(hidden($0)))
  $0 = ""
  while (match(rest, /\[[^][]*\]\([^() ]+\)/)) {
    found = substr(rest, RSTART, RLENGTH)
    $0 = $0 substr(rest, 1, RSTART - 1)
    rest = substr(rest, RSTART + RLENGTH)
    text = found
    sub(/\]\(.*/, "", text)
    link = found
    sub(/.*\]\(/, "", link)
    sub(/\)$/, "", link)
    link = target(link)
    $0 = $0 (link == "" ? substr(text, 2) : text "](" link ")")
  }
  $0 = shown($0 rest)
}
{ print }
