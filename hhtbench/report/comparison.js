const hidden = new Set();
const boxes = [...document.querySelectorAll(".plot")];
const buttons = [...document.querySelectorAll(".legend .solver")];

function visible(figure) {
  return figure.data.map(trace => !hidden.has(trace.name));
}

function draw(box) {
  if (box.dataset.drawn) return;
  box.dataset.drawn = "yes";
  const figure = figures[box.dataset.figure];
  const shown = visible(figure);
  figure.data.forEach((trace, index) => { trace.visible = shown[index]; });
  figure.layout.height = box.clientHeight;
  if (box.clientWidth < 480) {
    figure.layout.margin = {l: 58, r: 10, t: 20, b: 50};
    figure.layout.font.size = 12;
    for (const name of ["xaxis", "yaxis"]) {
      const axis = figure.layout[name];
      delete axis.minor;
      if (axis.tickvals) {
        const kept = (_, index, all) => all.length < 6 || index % 2 === 0;
        axis.tickvals = axis.tickvals.filter(kept);
        axis.ticktext = axis.ticktext.filter(kept);
      }
      else if (typeof axis.dtick === "number" && axis.range[1] - axis.range[0] > 4) axis.dtick *= 2;
    }
  }
  Plotly.newPlot(box, figure.data, figure.layout, {...config, displayModeBar: box.clientWidth < 480 ? false : "hover"});
}

function refresh() {
  for (const button of buttons) button.setAttribute("aria-pressed", String(!hidden.has(button.dataset.entry)));
  for (const box of boxes) if (box.data) Plotly.restyle(box, {visible: visible(box)});
}

for (const button of buttons) {
  const entry = button.dataset.entry;
  button.addEventListener("click", () => { hidden.has(entry) ? hidden.delete(entry) : hidden.add(entry); refresh(); });
  button.addEventListener("dblclick", () => { buttons.forEach(other => hidden.add(other.dataset.entry)); hidden.delete(entry); refresh(); });
}
for (const button of document.querySelectorAll("[data-all]")) {
  button.addEventListener("click", () => {
    hidden.clear();
    if (button.dataset.all === "false") buttons.forEach(other => hidden.add(other.dataset.entry));
    refresh();
  });
}

// Charts near the window first, the others one by one in pauses: the page answers at once however many there are.
const watch = new IntersectionObserver(entries => {
  for (const entry of entries) if (entry.isIntersecting) { watch.unobserve(entry.target); draw(entry.target); }
}, {rootMargin: "600px"});
boxes.forEach(box => watch.observe(box));
function drawNext() {
  const box = boxes.find(other => !other.dataset.drawn);
  if (box) { draw(box); setTimeout(drawNext, 30); }
}
setTimeout(drawNext, 30);
addEventListener("beforeprint", () => boxes.forEach(draw));
