# Fetch and unpack with BitBake's own fetchers; the other tasks do nothing unless a class or a recipe says what.
def base_fetcher(d):
    return bb.fetch2.Fetch((d.getVar("SRC_URI") or "").split(), d)

addtask fetch
python base_do_fetch() {
    base_fetcher(d).download()
}

addtask unpack after do_fetch
python base_do_unpack() {
    folder = d.getVar("UNPACKDIR") or d.getVar("WORKDIR")
    bb.utils.mkdirhier(folder)
    base_fetcher(d).unpack(folder)
}

addtask configure after do_unpack
do_configure[dirs] = "${B}"
base_do_configure() {
    :
}

addtask compile after do_configure
do_compile[dirs] = "${B}"
base_do_compile() {
    :
}

addtask install after do_compile
do_install[cleandirs] = "${D}"
base_do_install() {
    :
}

bbfatal() {
    echo "ERROR: $*" >&2
    exit 1
}

EXPORT_FUNCTIONS do_fetch do_unpack do_configure do_compile do_install
