"use strict";
(() => {
  const round = (v) => (v === null || v === undefined ? "n/a" : String(v));

  // A slider over frames: six pictures and their scores.
  for (const figure of document.querySelectorAll(".panels")) {
    const frames = JSON.parse(figure.querySelector("script").textContent);
    const input = figure.querySelector("input");
    const images = figure.querySelectorAll("img");
    const show = () => {
      const frame = frames[input.value];
      figure.querySelector("output").textContent = frame.index;
      figure.querySelector(".scores").textContent = frame.text;
      images.forEach((image, i) => {
        image.hidden = frame.pictures[i] === null;
        if (frame.pictures[i] !== null) image.src = frame.pictures[i];
      });
    };
    input.addEventListener("input", show);
    show();
  }

  // Where a frame is on the path.
  const paths = [...document.querySelectorAll(".path")].map((figure) => {
    const places = JSON.parse(figure.dataset.path), indices = JSON.parse(figure.dataset.indices);
    const here = figure.querySelector(".here");
    return (frame) => {
      const place = frame === null ? null : places[indices.indexOf(frame)];
      here.style.opacity = place ? 1 : 0;
      if (place) { here.setAttribute("cx", place[0]); here.setAttribute("cy", place[1]); }
    };
  });

  // What a chart says under a finger.
  for (const figure of document.querySelectorAll(".chart")) {
    const data = JSON.parse(figure.dataset.chart);
    const plot = figure.querySelector("svg"), cursor = figure.querySelector(".cursor");
    const said = figure.querySelector("output");
    const first = data.x[0], last = data.x[data.x.length - 1];
    const leave = () => { cursor.style.opacity = 0; said.textContent = ""; paths.forEach((mark) => mark(null)); };
    const move = (event) => {
      const box = plot.getBoundingClientRect();
      const x = first + ((event.clientX - box.left) / box.width) * (last - first);
      let nearest = 0;
      data.x.forEach((v, i) => { if (Math.abs(v - x) < Math.abs(data.x[nearest] - x)) nearest = i; });
      const at = data.x[nearest];
      cursor.style.opacity = 0.5;
      cursor.style.left = `${plot.offsetLeft || box.left - plot.parentElement.getBoundingClientRect().left}px`;
      cursor.style.transform = `translateX(${(box.width * (at - first)) / Math.max(last - first, 1e-9)}px)`;
      const unit = data.unit.split(" ")[0];
      const values = data.series.map((s) => `${data.series.length > 1 ? s.name + " " : ""}${round(s.y[nearest])} ${unit}`);
      said.textContent = `${data.label} ${at}: ${values.join(", ")}`;
      paths.forEach((mark) => mark(at));
    };
    plot.addEventListener("pointermove", move);
    plot.addEventListener("pointerdown", move);
    plot.addEventListener("pointerleave", leave);
  }
})();
