async function unpacked(element) {
  const bytes = Uint8Array.from(atob(element.textContent), letter => letter.charCodeAt(0));
  return new Response(new Blob([bytes]).stream().pipeThrough(new DecompressionStream("gzip"))).text();
}

const figures = {};  // by number
const clear = "rgba(0, 0, 0, 0)";  // figures show the page's ground, light or dark

// The same with every text in its place.
function completed(value, texts) {
  if (typeof value !== "object" || value === null) return value;
  if ("$" in value) return texts[value.$];
  for (const name of Object.keys(value)) value[name] = completed(value[name], texts);
  return value;
}

// Takes in the figures of a part of the page, and returns its HTML.
async function taken(element) {
  const part = JSON.parse(await unpacked(element));
  for (const [number, figure] of Object.entries(completed(part.figures, part.texts))) {
    figure.layout.paper_bgcolor = figure.layout.plot_bgcolor = clear;
    figure.layout.modebar = {bgcolor: clear, color: "#767676", activecolor: "#222222"};
    figures[number] = figure;
  }
  return part.html;
}

await taken(document.getElementById("figures"));
const library = document.createElement("script");
library.textContent = await unpacked(document.getElementById("plotly"));
document.head.append(library);
const config = {responsive: true, displaylogo: false, displayModeBar: "hover", modeBarButtonsToRemove: ["select2d", "lasso2d"]};

function values(array) {
  if (!array?.bdata) return array ?? [];
  const bytes = Uint8Array.from(atob(array.bdata), letter => letter.charCodeAt(0));
  return [...new {f4: Float32Array, f8: Float64Array}[array.dtype](bytes.buffer)];
}

// What a figure shows, a line a point; a mark at the edge has no value there.
function csv({data, layout}) {
  const cell = value => typeof value === "number" ? value : `"${String(value ?? "").replaceAll("<br>", "; ").replaceAll('"', '""')}"`;
  const lines = [["curve", layout.xaxis.title?.text ?? "x", layout.yaxis.title?.text ?? "y", "note"]];
  for (const trace of data) {
    const y = trace.meta ? [trace.meta.y] : values(trace.y);
    const text = [trace.text ?? ""].flat();
    (trace.meta ? [trace.meta.x] : values(trace.x)).forEach((x, index) => lines.push([trace.name, x, y[index], text[index] ?? text[0]]));
  }
  return lines.map(line => line.map(cell).join(",")).join("\n") + "\n";
}

// A link to its data below every figure in a part of the page.
function linkData(part) {
  for (const box of part.querySelectorAll(".plot")) {
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
}
linkData(document);

// Plots near the window first, the others one by one in pauses: the page answers at once however many there are.
let watch, pause;
let finish = () => {};
function drawAll(draw) {
  const boxes = [...document.querySelectorAll(".plot")];
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
