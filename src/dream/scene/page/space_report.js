
// ---- in three dimensions

const space = new SpaceView();
document.addEventListener("step", ({ detail }) => space.show(detail));
{
  const { scene, problem } = JSON.parse(at("space-data").textContent);
  at("space-note").textContent = problem ?? "";
  at("space-note").hidden = !problem;
  at("space-body").hidden = !scene;
  if (scene) space.open(scene);
}
