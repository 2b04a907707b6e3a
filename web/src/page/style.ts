// Looks of the element; dark or light as the system says.

export const STYLE = `
:host { display: block; position: relative; overflow: hidden; min-height: 8rem; background: #000;
  color-scheme: light dark;
  font: 13px/1.45 system-ui, sans-serif; }
.whole { position: absolute; inset: 0; display: grid; overflow: hidden; container-type: size;
  grid-template: "scene side" minmax(0, 1fr) "bar bar" auto / minmax(0, 1fr) auto; }
.scene { grid-area: scene; position: relative; touch-action: none; }
canvas { position: absolute; inset: 0; width: 100%; height: 100%; display: block; }
canvas.over { grid-area: scene; position: static; }
.scene.cooperative { touch-action: pan-x pan-y; }
.hint { position: absolute; inset: auto 0 1rem; z-index: 1; width: fit-content; max-width: 90%; margin: 0 auto;
  padding: .3rem .7rem; border-radius: .3rem; color: #fff; background: #000c; pointer-events: none; opacity: 0;
  transition: opacity .3s; }
.hint.shown { opacity: 1; }
.scene:focus { outline: none; }
.scene:focus-visible::after { content: ""; position: absolute; inset: 0; pointer-events: none;
  border: 3px solid #fff; outline: 3px solid #1a56db; outline-offset: -6px; }
button:focus-visible, input:focus-visible, select:focus-visible { outline: 3px solid Highlight; outline-offset: 1px; }
canvas.over, canvas.first { pointer-events: none; visibility: hidden; }
canvas.over.shown, canvas.first.shown { visibility: visible; }
.panel { display: contents; color: CanvasText; }
.foot { grid-area: bar; position: relative; min-width: 0; color: CanvasText; }
[hidden] { display: none !important; }
.bar { display: flex; flex-wrap: wrap; align-items: center; gap: 0 .6rem; padding: .1rem .75rem; background: Canvas;
  box-sizing: border-box; max-height: 50cqh; overflow: auto; }
.bar p { margin: 0; }
.title { font-weight: 600; max-width: 60%; overflow: hidden; text-overflow: ellipsis; white-space: nowrap; }
.state { flex: 1; min-width: 0; overflow-wrap: anywhere; }
.state.bad { flex-basis: 100%; order: 1; color: light-dark(#a00, #ff8a80); font-weight: 600; }
.laboratory[hidden] ~ .foot .state.done { position: absolute; clip-path: inset(50%); }
.player { flex: 1 1 100%; align-items: center; gap: .6rem; white-space: nowrap; }
.laboratory { grid-area: side; width: 17rem; overflow: auto; box-sizing: border-box; padding: .6rem .8rem;
  color: CanvasText; background: Canvas; }
@media (max-width: 560px) {
  .whole { grid-template: "scene" minmax(50%, 1fr) "side" auto "bar" auto / minmax(0, 1fr); }
  .laboratory { width: auto; max-height: 40vh; }
  .title { max-width: calc(100% - 13rem); }
}
progress { position: absolute; inset: -3px 0 auto; display: block; width: 100%; height: 3px; border: 0;
  appearance: none; background: Canvas; }
progress::-webkit-progress-bar { background: Canvas; }
progress::-webkit-progress-value { background: light-dark(#1a56db, #8ab4f8); }
progress::-moz-progress-bar { background: light-dark(#1a56db, #8ab4f8); }
progress.full { visibility: hidden; }
dl { display: grid; grid-template-columns: auto 1fr; gap: .1rem .8rem; margin: .4rem 0; }
dd { margin: 0; text-align: right; font-variant-numeric: tabular-nums; }
label, fieldset { display: block; margin: .4rem 0; }
fieldset { border: 0; padding: 0; display: flex; justify-content: space-between; }
input[type=radio] { margin: 0 .25rem 0 0; }
fieldset label { margin: 0; }
select, input[type=range] { width: 100%; box-sizing: border-box; }
button { font: inherit; margin: .2rem .3rem .2rem 0; }
.bar button { flex: none; margin: .2rem 0; }
.state + button { margin-inline-start: auto; }
@media (pointer: coarse) {
  button, select, input[type=range], fieldset label { min-height: 44px; }
  button { min-width: 44px; }
}
.help { margin: .4rem 0 0; }
`;
