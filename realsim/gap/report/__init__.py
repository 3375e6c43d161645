"""The diagnosis as a page: verdict, where, what, how much, and the evidence."""

from realsim.gap.report.document import diagnosis_page as diagnosis_page
from realsim.gap.report.document import write_report as write_report
