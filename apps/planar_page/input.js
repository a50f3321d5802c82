// --- Pointer and keyboard -------------------------------------------------------------------------

const place = event => {
  const box = $("map").getBoundingClientRect();
  return [VIEW.left + (event.clientX - box.left) / scale, VIEW.top - (event.clientY - box.top) / scale];
};
function listen() {
  const map = $("map");
  let held = false;
  map.onpointerdown = event => {
    held = true;
    if (event.isTrusted) map.setPointerCapture(event.pointerId);
    map.focus({preventScroll: true});
    event.preventDefault();
    if (page.tool === "draw") { page.line = place(event); page.dirty = true; } else drag(place(event));
  };
  map.onpointermove = event => {
    if (!held) return;
    if (page.tool === "draw") { page.line.push(...place(event)); page.dirty = true; } else drag(place(event));
  };
  map.onpointerup = map.onpointercancel = () => {
    if (held && page.tool === "draw") endLine();
    held = false;
  };
  let back = false;
  const lookBack = event => {
    if (!page.history.length) return;
    run(false);
    const box = $("strip").getBoundingClientRect(), longest = Math.max(60, page.history.length - 1);
    page.at = Math.max(0, Math.min(page.history.length - 1, Math.round((event.clientX - box.left - 10) / (box.width - 20) * longest)));
    page.dirty = true;
  };
  $("strip").onpointerdown = event => { back = true; lookBack(event); };
  $("strip").onpointermove = event => { if (back) lookBack(event); };
  addEventListener("pointerup", () => { back = false; });
  $("run").onclick = () => run(!page.running);
  $("step").onclick = () => { run(false); control(); page.share = 1; };
  $("again").onclick = () => { run(false); newStart(true); };
  $("compare").onclick = compare;
  $("prepared").onclick = () => openScene(page.scene);
  $("clear").onclick = () => { call("clear"); run(false); learn(); setTool("draw"); };
  $("show-certificate").onchange = $("show-preview").onchange = () => { page.dirty = true; };
  for (const button of $("pad").querySelectorAll("button")) {
    button.onpointerdown = event => { event.preventDefault(); pushes(button.dataset.push, true); };
    button.onpointerup = button.onpointerleave = button.onpointercancel = button.onblur = () => pushes(button.dataset.push, false);
    button.onkeydown = event => { if (event.key === "Enter" || event.key === " ") { event.preventDefault(); event.stopPropagation(); pushes(button.dataset.push, true); } };
    button.onkeyup = () => pushes(button.dataset.push, false);
  }
  const ARROWS = {ArrowLeft: "-1,0", ArrowRight: "1,0", ArrowUp: "0,1", ArrowDown: "0,-1"};
  addEventListener("keydown", event => {
    const typing = event.target.matches("input[type=number], input[type=range]"), group = event.target.closest("[role=radiogroup]");
    if (typing || event.ctrlKey || event.metaKey || event.altKey) return;
    const direction = ARROWS[event.key];
    if (direction && group) {
      const buttons = [...group.children], step = direction === "1,0" || direction === "0,-1" ? 1 : -1;
      const next = buttons[(buttons.indexOf(event.target) + step + buttons.length) % buttons.length];
      next.focus();
      next.click();
    } else if (direction && page.tool === "draw") {
      page.pen ||= scene().start.slice(0, 2);
      page.line ||= [...page.pen];
      page.pen = page.pen.map((v, i) => v + .08 * +direction.split(",")[i]);
      page.line.push(...page.pen);
      page.dirty = true;
    } else if (direction && page.running) {
      pushes(direction, true);
    } else if (direction) {
      drag(page.robot.map((v, i) => v + .03 * +direction.split(",")[i]));
    } else if (event.key === "Enter" && page.tool === "draw" && page.line) {
      endLine();
    } else if (event.key === "Escape") {
      page.line = page.pen = null;
      page.dirty = true;
    } else if (event.key === " " && event.target.tagName !== "BUTTON" && event.target.type !== "checkbox" && event.target.tagName !== "SUMMARY") {
      run(!page.running);
    } else if (event.key === ".") {
      $("step").click();
    } else if (event.key === "r") {
      $("again").click();
    } else if (event.key === "m" || event.key === "d") {
      setTool(event.key === "m" ? "move" : "draw");
    } else if (event.key >= "1" && event.key <= String(world.methods.length)) {
      setMethod(+event.key - 1);
    } else {
      return;
    }
    event.preventDefault();
  });
  addEventListener("keyup", event => { if (ARROWS[event.key]) pushes(ARROWS[event.key], false); });
  addEventListener("blur", () => [...push].forEach(d => pushes(d, false)));
  new ResizeObserver(size).observe(map);
  matchMedia("(prefers-color-scheme: dark)").addEventListener("change", readColours);
}

function choices(group, labels, pick) {
  for (const [i, label] of labels.entries()) {
    const button = document.createElement("button");
    button.setAttribute("role", "radio");
    button.innerHTML = label;
    button.onclick = () => pick(i);
    $(group).append(button);
  }
}

const ready = createKernel().then(made => {
  kernel = made;
  world = JSON.parse(kernel.UTF8ToString(kernel._page_describe()));
  choices("scenes", world.scenes.map(s => s.name), i => { run(false); openScene(i); });
  choices("methods", world.methods.map((m, i) => `${METHODS[m.name][0]} <kbd>${i + 1}</kbd>`), setMethod);
  [...$("tools").children].forEach(button => button.onclick = () => setTool(button.dataset.tool));
  readColours();
  size();
  listen();
  setMethod(page.method);
  openScene(0);
  requestAnimationFrame(frame);
}).catch(error => say(`This page needs a browser with SIMD and exceptions in WebAssembly: ${error.message || error}`));
