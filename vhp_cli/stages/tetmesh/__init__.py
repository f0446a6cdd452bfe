"""Stage `tetmesh`: the tissues of a model as one conforming, labelled tetrahedral mesh."""
