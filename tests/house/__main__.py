"""Print the ratchets of the code: python -m tests.house ["NAME OF A COUNT"].

Without a name: today's numbers and their bounds. With one: the places.
"""

import sys

from tests.house.ratchet import read_ratchets, table_lines
from tests.house.survey import survey_program

SURVEY, RATCHETS = survey_program(), read_ratchets()
NAMES = sys.argv[1:]
if NAMES and NAMES[0] not in RATCHETS["counts"]:
    sys.exit(f"no count {NAMES[0]!r}; there are: {', '.join(RATCHETS['counts'])}")
lines = SURVEY.places[NAMES[0]] if NAMES else table_lines(SURVEY, RATCHETS)
print("\n".join(lines))
