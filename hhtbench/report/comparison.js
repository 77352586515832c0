let base = "front";  // who is shown where nobody has clicked: "front", "all" or "none"
const clicked = new Map();  // solver -> shown or not
const buttons = [...document.querySelectorAll(".legend .solver")];
const solvers = new Set(buttons.map(button => button.dataset.entry));
const inFront = () => new Set(Object.values(figures).flatMap(figure => figure.front ?? []));

function isShown(entry, front) {
  return clicked.get(entry) ?? (base === "all" || (base === "front" && (!front || front.includes(entry))));
}

function tailored(box) {
  const {data, layout, front} = structuredClone(figures[box.dataset.figure]);
  for (const trace of data) trace.visible = !solvers.has(trace.name) || isShown(trace.name, front);
  layout.height = box.clientHeight;
  if (box.clientWidth < 480) {
    layout.margin = {l: 58, r: 10, t: 20, b: 50};
    layout.font.size = 12;
    for (const trace of data) trace.mode = trace.mode.replace("+text", "");
    for (const axis of [layout.xaxis, layout.yaxis]) {
      delete axis.minor;
      if (axis.tickvals) {
        const kept = (_, index, all) => all.length < 6 || index % 2 === 0;
        axis.tickvals = axis.tickvals.filter(kept);
        axis.ticktext = axis.ticktext.filter(kept);
      }
      else if (typeof axis.dtick === "number" && axis.range[1] - axis.range[0] > 4) axis.dtick *= 2;
    }
    const names = layout.yaxis.categoryarray;
    if (names) {  // of problems: small, arguments below, and without a title, or they take half of the width
      Object.assign(layout.margin, {l: 0, r: 2});
      delete layout.yaxis.title;
      layout.yaxis.tickfont = {size: 9};
      layout.yaxis.tickvals = names;
      layout.yaxis.ticktext = names.map(name => name.replace("(", "<br>("));
    }
  }
  return {data, layout};
}

function draw(box) {
  const {data, layout} = tailored(box);
  Plotly.react(box, data, layout, {...config, displayModeBar: box.clientWidth < 480 ? false : "hover"});
}

function refresh() {
  const first = [...inFront()];
  for (const button of buttons) button.setAttribute("aria-pressed", String(isShown(button.dataset.entry, first)));
  for (const button of document.querySelectorAll("[data-base]")) {
    button.setAttribute("aria-pressed", String(!clicked.size && button.dataset.base === base));
  }
  drawAll(draw);
}

for (const button of buttons) {
  const entry = button.dataset.entry;
  button.addEventListener("click", () => { clicked.set(entry, button.ariaPressed !== "true"); refresh(); });
  button.addEventListener("dblclick", () => { base = "none"; clicked.clear(); clicked.set(entry, true); refresh(); });
}
for (const button of document.querySelectorAll("[data-base]")) {
  button.addEventListener("click", () => { base = button.dataset.base; clicked.clear(); refresh(); });
}

// A view of a figure with its caption.
onButton(".views button", button => {
  const figure = button.closest("figure");
  const box = figure.querySelector(".plot");
  press(button);
  box.dataset.figure = button.dataset.figure;
  for (const caption of figure.querySelectorAll(".caption")) caption.hidden = caption.dataset.figure !== button.dataset.figure;
  if (box.data) draw(box);
});

// A part of the page is decompressed when it is opened for the first time, also by a link to it.
async function unfold(part) {
  const packed = part.querySelector(":scope > script");
  if (!packed || !part.open) return;
  packed.remove();
  const body = document.createElement("div");
  body.innerHTML = await taken(packed);
  part.append(body);
  linkData(body);
  refresh();
}

function openTarget() {
  const target = location.hash && document.getElementById(location.hash.slice(1));
  if (target?.tagName === "DETAILS") target.open = true;
}

for (const part of document.querySelectorAll("details.part")) part.addEventListener("toggle", () => unfold(part));
addEventListener("hashchange", openTarget);
openTarget();
refresh();
