"""Whether a log can be believed: its arrays, its units and conventions, how its runs begin."""

from realsim.gap.health.examine import examine as examine
from realsim.gap.health.examine import gathered as gathered
