async function unpacked(id) {
  const bytes = Uint8Array.from(atob(document.getElementById(id).textContent), letter => letter.charCodeAt(0));
  return new Response(new Blob([bytes]).stream().pipeThrough(new DecompressionStream("gzip"))).text();
}
const library = document.createElement("script");
library.textContent = await unpacked("plotly");
document.head.append(library);
const figures = JSON.parse(await unpacked("figures"));
const clear = "rgba(0, 0, 0, 0)";  // figures show the page's ground, light or dark
for (const {layout} of figures) {
  layout.paper_bgcolor = layout.plot_bgcolor = clear;
  layout.modebar = {bgcolor: clear, color: "#767676", activecolor: "#222222"};
}
const config = {responsive: true, displaylogo: false, displayModeBar: "hover", modeBarButtonsToRemove: ["select2d", "lasso2d"]};
const boxes = [...document.querySelectorAll(".plot")];

function values(array) {
  if (!array?.bdata) return array ?? [];
  const bytes = Uint8Array.from(atob(array.bdata), letter => letter.charCodeAt(0));
  return [...new {f4: Float32Array, f8: Float64Array}[array.dtype](bytes.buffer)];
}

// What a figure shows, a line a point; a mark at the edge has no value there.
function csv({data, layout}) {
  const cell = value => typeof value === "number" ? value : `"${String(value ?? "").replaceAll("<br>", "; ").replaceAll('"', '""')}"`;
  const lines = [["curve", layout.xaxis.title?.text ?? "x", layout.yaxis.title?.text ?? "y", "remark"]];
  for (const trace of data) {
    const y = trace.meta ? [trace.meta.y] : values(trace.y);
    const text = [trace.text ?? ""].flat();
    (trace.meta ? [trace.meta.x] : values(trace.x)).forEach((x, index) => lines.push([trace.name, x, y[index], text[index] ?? text[0]]));
  }
  return lines.map(line => line.map(cell).join(",")).join("\n") + "\n";
}

for (const box of boxes) {
  const link = document.createElement("a");
  link.textContent = "data as CSV";
  link.className = "csv";
  link.href = "#";
  link.addEventListener("click", () => {
    link.download = `${(box.closest("[id]")?.id ?? "figure")}-${box.dataset.figure}.csv`;
    link.href = URL.createObjectURL(new Blob([csv(figures[box.dataset.figure])], {type: "text/csv"}));
  });
  box.after(link);
}

// Plots near the window first, the others one by one in pauses: the page answers at once however many there are.
let watch, pause;
let finish = () => {};
function drawAll(draw) {
  watch?.disconnect();
  clearTimeout(pause);
  for (const box of boxes) delete box.dataset.drawn;
  const once = box => { if (!box.dataset.drawn) { box.dataset.drawn = "yes"; draw(box); } };
  watch = new IntersectionObserver(entries => {
    for (const entry of entries) if (entry.isIntersecting) { watch.unobserve(entry.target); once(entry.target); }
  }, {rootMargin: "600px"});
  boxes.forEach(box => watch.observe(box));
  const next = () => {
    const box = boxes.find(other => !other.dataset.drawn);
    if (box) { once(box); pause = setTimeout(next, 30); }
  };
  pause = setTimeout(next, 30);
  finish = () => boxes.forEach(once);
}
addEventListener("beforeprint", () => finish());
