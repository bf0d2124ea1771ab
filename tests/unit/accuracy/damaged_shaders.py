"""Ways to break what OpenGL draws: one place of a shader's text changed, and the programs compiled again.

The rasteriser that stands in for OpenGL has code of its own, and is found out when it is compared with OpenGL.
"""

import atexit
import shutil
from pathlib import Path
from tempfile import mkdtemp

from services.rendering.opengl import context

FOLDERS = mkdtemp(prefix="shaders-")
atexit.register(shutil.rmtree, FOLDERS, ignore_errors=True)


def shader(file: str, old: str, new: str):
    """Replaces `old` by `new` in a shader; there must be such a place."""

    def apply(patch) -> None:
        renderer = type(context.current().renderer)
        from services.rendering.opengl import mesh_upload  # imports OpenGL, so after the context

        folder, made = Path(mkdtemp(dir=FOLDERS)), {}
        for path in mesh_upload.SHADERS.iterdir():
            shutil.copy(path, folder)
        text = (folder / file).read_text()
        assert old in text, f"{file} has no {old!r}"
        (folder / file).write_text(text.replace(old, new))

        def compiled(_, fragment, **kinds):
            key = fragment, tuple(kinds.items())
            if key not in made:
                made[key] = mesh_upload.Program(fragment, {name.upper(): int(kind) for name, kind in kinds.items()})
            return made[key]

        patch.setattr(mesh_upload, "SHADERS", folder)
        patch.setattr(renderer, "program", compiled)

    return apply


no_inverse_pi = shader("radiance.frag", "irradiance / PI", "irradiance")
inverse_distance = shader("radiance.frag", "/ distance2;", "* inversesqrt(distance2);")
no_gloss = shader("radiance.frag", "+ gloss, opacity", ", opacity")
flat_sky = shader("radiance.frag", "(1.0 + n.y / 3.0)", "1.0")
color_squared = shader("radiance.frag", "base_colors[k] * texel", "base_colors[k] * base_colors[k] * texel")
no_fresnel = shader("radiance.frag", "* fresnel(1.0, dot(v, h))", "* NORMAL_REFLECTANCE")
other_half_vector = shader("radiance.frag", "normalize(l + v)", "(0.5 * (l + v))")
light_on_both_sides = shader("radiance.frag", "max(dot(n, l), 0.0) / distance2", "abs(dot(n, l)) / distance2")
short_normals = shader("surface.frag", "n = normalize(n);", "")
texture_upside_down = shader("surface.frag", "texture_uv);", "vec2(texture_uv.x, 1.0 - texture_uv.y));")
texture_mirrored = shader("surface.frag", "texture_uv);", "vec2(1.0 - texture_uv.x, texture_uv.y));")
texture_not_repeated = shader("surface.frag", "texture_uv);", "clamp(texture_uv, 0.001, 0.999));")
texture_as_displayed = shader("surface.frag", "return texel.rgb;", "return pow(texel.rgb, vec3(1.0 / 2.2));")
other_texture_curve = shader("surface.frag", "return texel.rgb;", "return pow(texel.rgb, vec3(2.2 / 2.4));")
holes_everywhere = shader("surface.frag", "texel.a < 0.5", "texel.a > 0.5")
