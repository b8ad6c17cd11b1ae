"""A certificate of its own making for a page, so that nobody in the network reads along.

No authority signed it: a browser warns once, and who compares the fingerprint that the terminal prints knows it is this
page. It is made anew for each run, for a day, and kept in memory.
"""

from collections.abc import Sequence
from datetime import UTC, datetime, timedelta
from ipaddress import ip_address

from ..errors import OptionError, install_line
from ..local_server import Identity


def own_identity(hosts: Sequence[str]) -> Identity:
    """Return a certificate for names and addresses of this computer, with its key (elliptic curve P-256).

    Raises
    ------
    OptionError
        If what it needs is not installed.
    """
    try:
        from cryptography import x509
        from cryptography.hazmat.primitives import hashes, serialization
        from cryptography.hazmat.primitives.asymmetric import ec
        from cryptography.x509.oid import ExtendedKeyUsageOID
    except ImportError:
        raise OptionError(f"--tls needs cryptography. Run: {install_line('gnomon[tls]')}") from None
    key, now = ec.generate_private_key(ec.SECP256R1()), datetime.now(UTC)
    name = x509.Name([x509.NameAttribute(x509.NameOID.COMMON_NAME, "gnomon live")])
    named = [
        x509.IPAddress(ip_address(host)) if host[0].isdigit() else x509.DNSName(host) for host in dict.fromkeys(hosts)
    ]
    certificate = (
        x509.CertificateBuilder(name, name, key.public_key(), x509.random_serial_number())
        .not_valid_before(now - timedelta(hours=1))
        .not_valid_after(now + timedelta(days=1))
        .add_extension(x509.SubjectAlternativeName(named), critical=False)
        .add_extension(x509.BasicConstraints(ca=False, path_length=None), critical=True)
        .add_extension(x509.ExtendedKeyUsage([ExtendedKeyUsageOID.SERVER_AUTH]), critical=False)
        .sign(key, hashes.SHA256())
    )
    form = serialization.PrivateFormat.PKCS8, serialization.NoEncryption()
    return Identity(
        certificate=certificate.public_bytes(serialization.Encoding.PEM),
        key=key.private_bytes(serialization.Encoding.PEM, *form),
        fingerprint=certificate.fingerprint(hashes.SHA256()).hex(":").upper(),
    )
