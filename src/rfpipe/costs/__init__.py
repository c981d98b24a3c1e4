"""What jobs take: memory, time and disk, predicted before they run from those that have run."""

from rfpipe.costs.jobs import JobCosts
from rfpipe.costs.model import Law, Laws, fit_laws
from rfpipe.costs.records import Record, Subject, read_shipped, records_in, write_records

__all__ = [
    "JobCosts",
    "Law",
    "Laws",
    "Record",
    "Subject",
    "fit_laws",
    "read_shipped",
    "records_in",
    "write_records",
]
