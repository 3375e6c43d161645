"""Whether a log can be believed: its arrays, its units and conventions, how its runs begin."""

from realsim.gap.case.health.examination import examine as examine
from realsim.gap.case.health.examination import gathered as gathered
