
// ---- in three dimensions

const space = new SpaceView();
document.addEventListener("step", ({ detail }) => space.show(detail));
space.take(JSON.parse(at("space-data").textContent));
