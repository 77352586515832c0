drawAll(box => {
  const {data, layout} = figures[box.dataset.figure];
  const narrow = box.clientWidth < 480;
  if (narrow) {
    layout.font.size = 10;
    layout.margin = {...layout.margin, l: 0, r: 2};
    layout.yaxis.automargin = true;
  }
  Plotly.newPlot(box, data, layout, {...config, displayModeBar: narrow ? false : "hover"});
});
