// A click on a header sorts its table by that column, another one the other way round.
const UNITS = {"µs": 1e-6, ms: 1e-3, s: 1, "%": 1};

// Numbers with their unit first, by size; then other texts.
function sortKey(cell) {
  const text = cell?.textContent.trim() ?? "";
  const found = text.match(/^(?:[≤≥≈] |[a-z ]+ )?(-?\d[\d.]*(?:,\d{3})*(?:e[-+]?\d+)?)\s*(µs|ms|s|%)?/);
  return found ? [0, Number(found[1].replaceAll(",", "")) * (UNITS[found[2]] ?? 1), text] : [1, 0, text];
}

function compared(a, b) {
  return a[0] - b[0] || a[1] - b[1] || a[2].localeCompare(b[2]);
}

function sortBy(header) {
  const sign = header.ariaSort === "ascending" ? -1 : 1;
  const body = header.closest("table").tBodies[0];
  const keyed = [...body.rows].map(row => [sortKey(row.cells[header.cellIndex]), row]);
  keyed.sort((a, b) => sign * compared(a[0], b[0]));
  body.append(...keyed.map(pair => pair[1]));
  for (const other of header.parentElement.cells) other.removeAttribute("aria-sort");
  header.ariaSort = sign > 0 ? "ascending" : "descending";
}

// Of several buttons one is pressed; the table of the pressed measure and bound of the drift is shown.
function press(button) {
  for (const other of button.parentElement.querySelectorAll("button")) other.setAttribute("aria-pressed", String(other === button));
}

function choose(button) {
  press(button);
  const chosen = [...document.querySelectorAll(".choose [aria-pressed=true]")].map(other => other.dataset.choice).join(" ");
  for (const table of document.querySelectorAll("[data-table]")) table.hidden = table.dataset.table !== chosen;
}

// What a click on a button that fits the selector does, also in a part of the page that is opened later.
function onButton(selector, act) {
  document.addEventListener("click", event => {
    const button = event.target.closest?.(selector);
    if (button) act(button);
  });
}

onButton("thead th button", button => sortBy(button.closest("th")));
onButton(".choose button", choose);
