import { useState } from "react";
import { createRoot } from "react-dom/client";
import { Viewer } from "splatwire/react";

function Scene() {
  const [state, setState] = useState("receiving");
  return (
    <>
      <Viewer
        src="/scene.swz"
        autorotate={6}
        onProgress={({ detail }) => setState(`${detail.packets} of ${detail.expected} packets`)}
        onError={({ detail }) => setState(detail.message)}
        onLoad={({ detail }) => setState(detail.verified ? "verified" : "with losses")}
      />
      <p>{state}</p>
    </>
  );
}

createRoot(document.getElementById("root")!).render(<Scene />);
