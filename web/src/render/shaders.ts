// Replacements for PlayCanvas's splat shader: footprint and falloff of 3DGS as in `splatwire.render`, cut where alpha
// falls below 1/255. PlayCanvas's own fixed cut and faded edge cost 15 dB.

import { numShTextures } from "./packed.ts";

export const CORNER = `
uniform vec4 viewport_size;
bool initCorner(SplatSource source, SplatCenter center, out SplatCorner corner) {
	vec4 q = getRotation().yzwx;
	vec3 s = getScale();
	mat3 R = quatToMat3(q.wxyz);
	mat3 T = mat3(center.modelView) * mat3(s.x * R[0], s.y * R[1], s.z * R[2]);
	vec2 focal = viewport_size.xy * vec2(center.projMat00, center.projMat11) * 0.5;
	vec3 v = center.view.xyz;
	vec2 limit = 1.3 / vec2(center.projMat00, center.projMat11);
	vec2 t = clamp(v.xy / v.z, -limit, limit);
	vec3 a = vec3(focal.x / v.z, 0.0, -focal.x * t.x / v.z) * T;
	vec3 b = vec3(0.0, focal.y / v.z, -focal.y * t.y / v.z) * T;
	float xx = dot(a, a) + 0.3, xy = dot(a, b), yy = dot(b, b) + 0.3;
	float opacity = getOpacity();
#if GSPLAT_AA
	corner.aaFactor = max(sqrt(max((xx - 0.3) * (yy - 0.3) - xy * xy, 0.0) / (xx * yy - xy * xy)), 0.001);
	opacity *= corner.aaFactor;
#endif
	float middle = 0.5 * (xx + yy), radius = length(vec2(0.5 * (xx - yy), xy));
	float l1 = middle + radius, l2 = max((xx * yy - xy * xy) / l1, 1e-6);
	float reach = sqrt(2.0 * max(log(opacity * 255.0), 0.0));
	vec2 axis = abs(xy) > 1e-9 ? normalize(vec2(xy, l1 - xx)) : (xx >= yy ? vec2(1.0, 0.0) : vec2(0.0, 1.0));
	corner.uv = source.cornerUV * reach;
	vec2 pixels = corner.uv.x * sqrt(l1) * axis + corner.uv.y * sqrt(l2) * vec2(axis.y, -axis.x);
	corner.offset = vec3(pixels * center.proj.ww * viewport_size.zw * 2.0, 0.0);
	return reach > 0.0;
}`;

export const COMMON = `
#include "gsplatHelpersVS"
#include "gsplatFormatVS"
#include "gsplatStructsVS"
#include "gsplatDeclarationsVS"
#include "gsplatModifyVS"
#include "gsplatEvalSHVS"
#include "gsplatQuatToMat3VS"
#include "gsplatReadVS"
#include "gsplatSourceVS"
#include "gsplatCenterVS"
#include "gsplatCornerVS"
#include "gsplatOutputVS"
uniform float alphaClipForward;
void clipCorner(inout SplatCorner corner, float alpha) {}
`;

export const FRAGMENT = `
varying highp vec2 gaussianUV;
flat varying mediump vec4 gaussianColor;
void main(void) {
	float alpha = min(exp(-0.5 * dot(gaussianUV, gaussianUV)) * gaussianColor.a, 0.99);
	if (alpha < 1.0 / 255.0) discard;
	gl_FragColor = vec4(gaussianColor.xyz * alpha, alpha);
}`;

/**
 * Returns the shader code that reads Gaussians of a degree. Harmonics are half floats, eight per texel of `dataSh0`,
 * `dataSh1`, ..., RGB per coefficient.
 */
export function readCode(degree: number): string {
  const number = (degree + 1) ** 2 - 1,
    textures = numShTextures(degree);
  const loads = Array.from({ length: textures }, (_, t) => `uvec4 t${t} = loadDataSh${t}();`).join("\n\t");
  const value = (n: number): string => `unpackHalf2x16(t${n >> 3}.${"xyzw"[(n >> 1) & 3]}).${"xy"[n & 1]}`;
  const coefficients = Array.from(
    { length: number },
    (_, j) => `sh[${j}] = vec3(${value(3 * j)}, ${value(3 * j + 1)}, ${value(3 * j + 2)});`,
  );
  const harmonics = number
    ? `
void readSHData(out vec3 sh[${number}], out float scale) {
	${loads}
	${coefficients.join("\n\t")}
	scale = 1.0;
}`
    : "";
  return `
vec4 cachedCenter;
vec3 getCenter() { cachedCenter = loadDataCenter(); return cachedCenter.xyz; }
vec4 getColor() { vec4 color = loadDataColor(); return vec4(color.rgb, cachedCenter.w > 0.0 ? color.a : 0.0); }
vec3 getScale() { return loadDataScale().xyz * max(cachedCenter.w, 1e-3); }
vec4 getRotation() { return loadDataRotation(); }
${harmonics}`;
}
