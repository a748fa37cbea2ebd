from .difference_page import write_difference_report as write_difference_report
from .html import write_report as write_report, write_tracks_report as write_tracks_report
from .people_page import write_people_report as write_people_report
from .pointing_page import write_pointing_report as write_pointing_report
from .reading import summarise as summarise
from .summary import Summary as Summary
