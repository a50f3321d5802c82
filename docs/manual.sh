# shellcheck shell=bash
# Implements ./dev docs. The script dev reads this file.

# tree_with TARGET FILE: prints the first preset whose build tree has the target and its file.
tree_with() {
  local preset
  for preset in release dev; do
    [ -e "build/$preset/$2" ] && grep -qs "^build $1:" "build/$preset/build.ninja" || continue
    printf '%s\n' "$preset"
    return
  done
  return 1
}

# without PAGE REASON: writes a page with the reason why the manual does not contain it.
without() {
  say "The manual is without ${1##*/}: $2"
  printf '<!DOCTYPE html>\n<meta charset="utf-8">\n<title>dfr</title>\n<p>This manual is without this page: %s.</p>\n' \
    "$2" >"$1"
}

cmd_docs() {
  need docs
  mkdir -p build/docs/html/mathjax/jax/output/SVG/fonts
  # Copies the parts of MathJax that draw TeX as SVG. Formulas then need no network.
  local mathjax=/usr/share/javascript/mathjax target=build/docs/html/mathjax
  cp -rL $mathjax/MathJax.js $mathjax/extensions $target
  cp -rL $mathjax/jax/{element,input} $target/jax
  cp -rL $mathjax/jax/output/SVG/{*.js,autoload} $target/jax/output/SVG
  cp -rL $mathjax/jax/output/SVG/fonts/TeX $target/jax/output/SVG/fonts
  doxygen docs/Doxyfile
  local tree out=build/docs/html
  if tree=$(tree_with study bin/study); then
    compile "$tree" study
    python3 -B docs/gallery.py "build/$tree/bin/study" docs/recorded/gallery.csv $out/gallery.html
  else
    without $out/gallery.html "./dev build has not built study"
  fi
  if tree=$(tree_with planar_page planar.html); then
    compile "$tree" planar_page
    cp "build/$tree/planar.html" $out
  elif command -v em++ >/dev/null; then
    without $out/planar.html "./dev build has not built planar_page"
  else
    without $out/planar.html "em++ is missing (apt-get install emscripten), which ./dev build needs for it"
  fi
  say "The manual is in build/docs/html/index.html"
}
