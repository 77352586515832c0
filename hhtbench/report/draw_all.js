drawAll(box => {
  const {data, layout} = figures[box.dataset.figure];
  const narrow = box.clientWidth < 480;
  if (narrow) {
    layout.font.size = 10;
    layout.margin = {...layout.margin, l: 0, r: 2};
    layout.yaxis.automargin = true;
    const names = layout.yaxis.categoryarray;
    if (names) {  // of problems: small, arguments below, and without a title, or they take half of the width
      delete layout.yaxis.title;
      layout.yaxis.tickfont = {size: 9};
      layout.yaxis.tickvals = names;
      layout.yaxis.ticktext = names.map(name => name.replace("(", "<br>("));
    }
  }
  Plotly.newPlot(box, data, layout, {...config, displayModeBar: narrow ? false : "hover"});
});
