"""Find forbidden phrases in texts, comments and names, also across line breaks; exit with status 1 if there are any.

    python .ci/phrases.py [FOLDER]

Write what a function does and what a value is: "prints", "reports", "returns", "not found", "expected ... got ...".
"""

import re
import sys
from pathlib import Path

FOLDERS = "docs", "examples", "src", "bench", "tests"  # and the documents beside them
KINDS = {".py", ".md", ".toml", ".ipynb", ".js", ".html", ".css", ".c", ".cpp", ".h"}
GAP = r"[\s#\"'/*>_]+"  # between words: line breaks with the marks of a comment or a string, or an underscore
FORMATS = "PLY|LAS|LAZ|COPC|E57|PCD|PTX|PTS|NPY|NPZ|OBJ|STL|glTF|OFF|SPZ|TOML|JSON|PNG|JPEG|EXR|HDR|TIFF?|MP4|ZIP"
PHRASES = [
    *("is told", "are told", "tells of", "so manieth", "somebody", "of which nothing", "is said", "what is asked of"),
    *("no errors here", "lets out", "are none", "of so many"),
    *(r"has not(?=[.;:!?)\"'])", rf"is no (?-i:{FORMATS})"),
]
PATTERN = re.compile("|".join(rf"(?<![a-z]){phrase.replace(' ', GAP)}(?![a-z])" for phrase in PHRASES), re.IGNORECASE)


def main(root: Path) -> int:
    """Print file, line and phrase of all findings below a folder and return the exit status."""
    files = [*root.glob("*.md"), *(file for folder in FOLDERS for file in sorted((root / folder).rglob("*")))]
    found = 0
    for file in files:
        text = file.read_text() if file.suffix in KINDS and ".min." not in file.name else ""
        for match in PATTERN.finditer(text):
            found += 1
            line = text.count("\n", 0, match.start()) + 1
            print(f"{file.relative_to(root)}:{line}: {re.sub(GAP, ' ', match[0])}")
    return 1 if found else 0


if __name__ == "__main__":
    sys.exit(main(Path(sys.argv[1] if len(sys.argv) > 1 else ".")))
