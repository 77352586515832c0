drawAll(box => {
  const figure = figures[box.dataset.figure];
  Plotly.newPlot(box, figure.data, figure.layout, config);
});
