import { Viewer } from "splatwire/react";

export default function Page() {
  return <Viewer src="/scene.swz" style={{ height: "30rem" }} />;
}
