// The settings as a scene that the package renders to the same picture.
function sceneXml(s) {
  const number = (x) => String(Number(x.toPrecision(9)));
  const rgb = (name, values) => `<rgb name="${name}" value="${values.map(number).join(", ")}"/>`;
  const float = (name, value) => `<float name="${name}" value="${number(value)}"/>`;
  const names = s.terms === "lecture" ? ["kd", "ks", "p"] : ["diffuse_reflectance", "specular_reflectance", "exponent"];

  const bsdf = (diffuse) => {
    const lines = [diffuse, float(names[1], s.ks), float(names[2], s.p)];
    const nested = [`<bsdf type="${s.lobe}">`, ...lines.map((line) => `    ${line}`), "</bsdf>"];
    return s.km === 0 ? nested
      : ['<bsdf type="mirrorblend">', `    ${float("km", s.km)}`, ...nested.map((line) => `    ${line}`), "</bsdf>"];
  };
  const indented = (lines) => lines.map((line) => `        ${line}`.split("\n").join("\n        ")).join("\n");

  const board = (name) => [
    `<texture name="${name}" type="checkerboard">`,
    `    ${rgb("color0", Array(3).fill(SQUARES[0]))}`,
    `    ${rgb("color1", Array(3).fill(SQUARES[1]))}`,
    `    <transform name="to_uv"><scale x="${FLOOR_HALF}" y="${FLOOR_HALF}"/></transform>`,
    "</texture>",
  ].join("\n    ");
  const matte = ['<bsdf type="diffuse">', `    ${board("reflectance")}`, "</bsdf>"];
  const floor = s.floor === "none" ? "" : `
    <shape type="rectangle">
        <transform name="to_world">
            <scale value="${FLOOR_HALF}"/>
            <rotate x="1" angle="-90"/>
            <translate y="-1"/>
        </transform>
${indented(s.floor === "matte" ? matte : bsdf(board(names[0])).join("\n").split("\n"))}
    </shape>
`;

  // In the physical convention the light needs pi d^2 times the intensity to be as bright at distance d.
  const gain = s.falloff ? Math.PI * REFERENCE_DISTANCE ** 2 : 1;
  const lights = s.lights.slice(0, s.count).map((light) => {
    const [x, y, z] = placed(light.azimuth, light.elevation, light.distance).map(number);
    return `
    <emitter type="point">
        <point name="position" x="${x}" y="${y}" z="${z}"/>
        ${rgb("intensity", scaled(channels(light.colour), light.intensity * gain))}
    </emitter>
`;
  }).join("");

  const picture = s.display === "linear" ? "explorer.png --linear" : "explorer.png";
  const convention = s.falloff ? '\n        <string name="convention" value="physical"/>' : "";
  return `<!--
    A ball from the explorer of phong_bsdf. The same picture, to 2/255:
    phong-bsdf render explorer.xml -o ${picture}
-->
<scene version="3.0.0">
    <integrator type="whitted">
        <integer name="max_depth" value="${MAX_DEPTH}"/>${convention}
    </integrator>

    <default name="spp" value="4"/>
    <default name="width" value="${SIZE}"/>
    <default name="height" value="${SIZE}"/>
    <sensor type="perspective">
        <float name="fov" value="${FIELD_OF_VIEW}"/>
        <transform name="to_world">
            <lookat origin="${placed(s.azimuth, s.elevation, EYE).map(number).join(", ")}" target="0, 0, 0" up="0, 1, 0"/>
        </transform>
        <sampler type="independent">
            <integer name="sample_count" value="$spp"/>
        </sampler>
        <film type="hdrfilm">
            <integer name="width" value="$width"/>
            <integer name="height" value="$height"/>
            <string name="pixel_format" value="rgb"/>
            <string name="component_format" value="float32"/>
            <rfilter type="box"/>
        </film>
    </sensor>

    <emitter type="constant">
        ${rgb("radiance", SKY)}
    </emitter>
${lights}
    <shape type="sphere">
${indented(bsdf(rgb(names[0], scaled(channels(s.colour), s.kd))))}
    </shape>
${floor}</scene>
`;
}
