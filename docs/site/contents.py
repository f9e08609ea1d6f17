"""What stands where on the site: the parts of the table of contents, and where pages come from."""

from __future__ import annotations

# Names are those of pages without suffix, in the order of the menu. Generated pages: `features`, `figures`, `gallery`,
# `contributing`, `changelog`, `tutorials/...`, `reference/...`. Pages that no part names come last, in a part of
# their own.
PARTS: dict[str, list[str]] = {
    "First steps": ["installation", "quick_start", "tutorials/quick_start", "features", "gallery"],
    "Tutorials": ["tutorials/index"],
    "How to": [
        "how_to/textures",
        "how_to/shapes",
        "how_to/cameras",
        "how_to/lights",
        "how_to/media",
        "how_to/caustics",
        "how_to/torch_bsdfs",
        "spectral",
        "polarisation",
        "gradient_index",
        "many_machines",
        "cuda",
        "how_to/reproducibility",
        "how_to/speed",
    ],
    "Interface": ["api", "reference/index", "derivatives"],
    "Background": ["theory", "glossary", "verification", "figures"],
    "Coming from elsewhere": ["from_mitsuba", "from_redner_and_pytorch3d"],
    "Project": ["contributing", "changelog"],
}
FURTHER = "Further pages"

# Pages with a list of chapters below them.
CHAPTERS: dict[str, list[str]] = {
    "api": [
        "api/scenes",
        "api/materials",
        "api/lights",
        "api/media",
        "api/spectra",
        "api/rendering",
        "api/differentiation",
        "api/rays",
        "api/tools",
    ],
    "theory": ["theory/motion", "theory/media", "theory/light_tracing", "theory/film"],
}

# Pages that are sections of the README: title, and the sections, whose headings go one level up if there are several.
FROM_README: dict[str, tuple[str, list[str]]] = {
    "features": ("What there is", ["What is there", "What is not there yet"]),
    "figures": ("Figures", ["Figures"]),
}
# The home page is the README up to this section, and the gallery's picture.
HOME_ENDS = "Installing"
