"""Types of the npm package: in old compilers, in templates of frameworks, and in imports without a document."""

import json
from pathlib import Path

import pytest

from web.installed import called, install, package

pytestmark = [pytest.mark.slow, pytest.mark.extended]

OTHERS = {
    "oldest": "npm:typescript@4.7.4", "old": "npm:typescript@5.0.4", "recent": "npm:typescript@5.9.3",
    "typescript": "7.0.2",
    "@types/react": "19.3.0", "react18": "npm:@types/react@18.3.32", "preact": "10.29.8", "solid-js": "1.9.19",
    "svelte": "5.57.3", "vue": "3.5.45",
}  # fmt: skip
ELEMENT = """
import "splatwire";
import type { SplatWire } from "splatwire";
import { Clip } from "splatwire/clip";
import { BitstreamError, decode, decodeClip, receive } from "splatwire/decoder";

const element: SplatWire = document.querySelector("splat-wire")!;
const loaded = ({ detail }: CustomEvent<{ complete: boolean; verified: boolean }>) => console.log(detail.verified);
element.addEventListener("load", loaded);
element.removeEventListener("load", loaded);
element.addEventListener("click", function (event) { console.log(event.clientX, this.src); });
element.addEventListener("lost", (event) => console.log(event.detail.retryMs), { once: true });
element.addEventListener("their-own", { handleEvent: (event: Event) => console.log(event.type) });
// @ts-expect-error: an event without this detail
element.addEventListener("error", ({ detail }) => console.log(detail.retryMs));
export const shown = decode(new Uint8Array(), { frame: 3 }).then(({ gaussians }) => gaussians.centres);
export const frames = decodeClip(new Uint8Array()).then((clip) => clip.frame(0).count * clip.clip.rate);
export const opened = Clip.open("/clip.swz").then((clip) => [clip.duration, clip.update()?.packed.count]);
export function watch(clip: Clip): EventTarget {
  clip.addEventListener("lost", ({ detail }) => console.log(detail.length, clip.live));
  const ended = (event: Event) => console.log(event.type);
  clip.addEventListener("ended", ended, { once: true });
  clip.removeEventListener("ended", ended);
  return clip;
}
export const failed = (error: unknown): boolean => error instanceof BitstreamError;
for await (const { gaussians, clip } of receive("/scene.swz")) console.log(gaussians.count, clip?.numFrames);
"""
REACT = """
import "splatwire";
import type { SplatWire } from "splatwire";
import * as React from "react";

export function Scene() {
  const ref = React.useRef<SplatWire>(null);
  const style = { height: 9 };
  return <splat-wire ref={ref} src="/scene.swz" panel="none" updates style={style} onload={(e) => e.detail.verified} />;
}
// @ts-expect-error: a typo
export const typo = <splat-wire scr="/scene.swz" />;
// @ts-expect-error: React would not call it
export const silent = <splat-wire src="/scene.swz" onLoad={() => undefined} />;
"""
VIEWER = """
import type { SplatWire } from "splatwire";
import { Viewer, type ViewerProps } from "splatwire/react";
import * as React from "react";

export const hotspot = <button slot="hotspot" data-position="0 1 2">Hat</button>;
export function Scene({ more }: { more: ViewerProps }) {
  const ref = React.useRef<SplatWire>(null);
  return (
    <Viewer
      ref={ref} {...more} title="a" role="img" tabIndex={0} hidden={false} aria-label="b" data-test="c" autorotate={6}
      onClick={(event) => event.currentTarget.saveView()} onLoad={({ detail }) => detail.verified}
    >
      {hotspot}
    </Viewer>
  );
}
// @ts-expect-error: a typo
export const typo = <Viewer scr="/scene.swz" />;
// @ts-expect-error: an event without this detail
export const wrong = <Viewer src="/scene.swz" onLoad={(event) => event.detail.message} />;
"""
JSX = """
import "splatwire";
export const scene = <splat-wire src="/scene.swz" panel="none" updates class="large" style={{ height: "9rem" }} />;
// @ts-expect-error: a typo
export const typo = <splat-wire scr="/scene.swz" />;
"""
SOLID = """
import "splatwire";
export const scene = <splat-wire on:load={(e) => e.detail.verified} on:firstpicture={(e) => e.detail.ms} />;
export const other = <splat-wire onLoad={(e) => e.detail.verified} onClick={(e) => e.clientX} />;
"""
TEMPLATES = """
import "splatwire";
import type { SvelteHTMLElements } from "svelte/elements";
import type { GlobalComponents } from "vue";
type Svelte = SvelteHTMLElements["splat-wire"];
export const svelte: Svelte = { src: "/scene.swz", class: "x", onload: (e) => e.detail.complete };
export const formerSvelte: Svelte = { src: "/scene.swz", "on:lost": (e) => e.detail.retryMs };
type Props = InstanceType<GlobalComponents["splat-wire"]>["$props"];
export const vue: Props = { src: "/scene.swz", class: "x", autorotate: 6, cameraLimits: "1 2 0 90" };
export const heard: Props = { onLoad: ({ detail }) => detail.verified, onClick: (event) => event.clientX };
// @ts-expect-error: a typo
export const typo: Props = { scr: "/scene.swz" };
// @ts-expect-error: a wrong value
export const wrong: Props = { panel: 3 };
"""


@pytest.fixture(scope="module")
def project(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("typed")
    install(folder, package(tmp_path_factory), OTHERS)
    return folder


def compiled(project: Path, compiler: str, name: str, code: str, **options: object) -> None:
    """Type-checks a file and the declarations of the package with a compiler, by the name of its folder."""
    (project / name).write_text(code)
    given = json.loads((project / "tsconfig.json").read_text())["compilerOptions"] | options
    config = project / f"tsconfig.{compiler}.{name}.json"
    config.write_text(json.dumps({"compilerOptions": given, "files": [name]}))
    called(["node", f"node_modules/{compiler}/bin/tsc", "-p", config.name], project)


@pytest.mark.parametrize(
    ("compiler", "resolution"),
    [("oldest", "node16"), ("old", "bundler"), ("recent", "bundler"), ("typescript", "bundler")],
)
def test_oldest_supported_compiler_accepts_the_declarations(project: Path, compiler: str, resolution: str) -> None:
    module = "node16" if resolution == "node16" else "esnext"
    paths = {"vue": ["./vue.d.ts"]}  # Vue's own declarations need a later compiler
    (project / "vue.d.ts").write_text("export interface HTMLAttributes { id?: string }\n")
    compiled(project, compiler, "element.ts", ELEMENT, module=module, moduleResolution=resolution, paths=paths)


@pytest.mark.parametrize("react", ["react", "react18"])
def test_react_types_include_the_element(project: Path, react: str) -> None:
    paths = {} if react == "react" else {"react": ["./node_modules/react18"], "react/*": ["./node_modules/react18/*"]}
    for jsx in ("react-jsx", "react"):
        compiled(project, "typescript", f"{react}.tsx", REACT, jsx=jsx, paths=paths)
        compiled(project, "typescript", f"{react}-viewer.tsx", VIEWER, jsx=jsx, paths=paths)


@pytest.mark.parametrize("source", ["preact", "solid-js"])
def test_preact_and_solid_types_include_the_element(project: Path, source: str) -> None:
    compiled(project, "typescript", f"{source}.tsx", JSX, jsx="react-jsx", jsxImportSource=source)


def test_solid_types_include_both_spellings_of_listeners(project: Path) -> None:
    compiled(project, "typescript", "listeners.tsx", SOLID, jsx="react-jsx", jsxImportSource="solid-js")


def test_svelte_and_vue_types_include_the_element(project: Path) -> None:
    compiled(project, "typescript", "templates.ts", TEMPLATES)


@pytest.mark.parametrize("entry", ["splatwire", "splatwire/strict"])
def test_element_is_importable_without_a_document(project: Path, entry: str) -> None:
    printed = called(
        ["node", "-e", f"import('{entry}').then(({{SplatWire}}) => console.log(typeof SplatWire))"], project
    )
    assert printed.strip() == "function"
