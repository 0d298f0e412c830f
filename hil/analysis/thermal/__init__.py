"""Parameters against temperature: which form predicts a temperature that was left out, and whether that helps.

result = fit_thermal(read_campaign("my-campaign"))
result.sensors[2].parameters["BA"].form      # constant, polynomial (with its order), monotone, table
result.model()                               # a hil.model/1 with curves that refuse to be extrapolated
"""

from hil.analysis.thermal.fit import ThermalFit, fit_thermal

__all__ = ["ThermalFit", "fit_thermal"]
